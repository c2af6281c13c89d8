"""Whatever is done to an experiment's tree, loading it gives an experiment or one clear error."""

from copy import deepcopy
from datetime import date
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from testbed.config import ConfigError, Experiment, dump, find, load

TREES = {name: dump(load(find(name))) for name in ("hold", "zhang2023_table_wrench")}
HUGE = [0.0, -0.0, 1e-320, 1e-9, 1.0, -1.0, 1e8, 1e300, float("nan"), float("inf"), -float("inf")]

scalars = (
    st.sampled_from(HUGE)
    | st.floats()
    | st.integers(-(2**70), 2**70)
    | st.booleans()
    | st.text(max_size=8)
    | st.just(date(2026, 1, 1))
)
values = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner),
    max_leaves=6,
)
known_names = sorted(
    {"type", "lambda", "start", "jets", "sat1", "o1", "table", "model", "k", "seed", "*", "a.b"}
)


def containers(node: Any) -> list[Any]:
    """Every table and list of a tree."""
    children = node.values() if isinstance(node, dict) else node if isinstance(node, list) else []
    inner = [found for child in children for found in containers(child)]
    return [node, *inner] if isinstance(node, dict | list) else inner


def spoil(tree: dict[str, Any], data: st.DataObject) -> None:
    """Delete, replace or add something somewhere."""
    places = [c for c in containers(tree) if c or isinstance(c, dict)]
    place = data.draw(st.sampled_from(places))
    action = data.draw(st.sampled_from(["delete", "replace", "nudge", "add"]))
    if action == "add" or not place:
        name, value = data.draw(st.text(max_size=6) | st.sampled_from(known_names)), None
        value = data.draw(values)
        place.append(value) if isinstance(place, list) else place.update({name: value})
        return
    key = data.draw(st.sampled_from(range(len(place)) if isinstance(place, list) else list(place)))
    if action == "delete":
        del place[key]
    elif action == "nudge" and type(place[key]) is float:
        place[key] *= data.draw(st.sampled_from([-1.0, 0.0, 1e-6, 0.1, 10.0, 1e6]))
    else:
        place[key] = data.draw(values)


def attempt(path: Path, overrides: tuple[str, ...]) -> Experiment | ConfigError:
    try:
        return load(path, overrides)
    except ConfigError as error:
        return error


def load_or_complain(path: Path, overrides: tuple[str, ...] = ()) -> None:
    match attempt(path, overrides):
        case ConfigError() as error:
            assert error.where
            assert error.expected
            assert error.found
            assert "values that do not fit it" not in error.found  # msgspec knew better than we
            assert str(error).replace("\n", "").isprintable()
            assert len(str(error)) < 1500
        case Experiment() as experiment:
            path.write_text(tomli_w.dumps(dump(experiment)), encoding="utf-8")
            assert load(path) == experiment


@pytest.mark.parametrize("name", TREES)
@settings(
    max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_a_spoilt_file(name, tmp_path, data):
    tree = deepcopy(TREES[name])
    for _ in range(data.draw(st.integers(1, 3))):
        spoil(tree, data)
    path = tmp_path / "e.toml"
    path.write_bytes(tomli_w.dumps(tree).encode("utf-8", "surrogatepass"))
    load_or_complain(path)


@settings(max_examples=150, deadline=None)
@given(st.binary(max_size=40), st.integers(0, 4000), st.integers(0, 40))
def test_spoilt_bytes(tmp_path_factory, junk, at, length):
    text = tomli_w.dumps(TREES["hold"]).encode()
    path = tmp_path_factory.mktemp("fuzz") / "e.toml"
    path.write_bytes(text[:at] + junk + text[at + length :])
    load_or_complain(path)


keys = st.lists(
    st.sampled_from([*TREES["zhang2023_table_wrench"], *known_names, "sat2", "mass", "[0]", "[*]"])
    | st.text(max_size=5),
    max_size=4,
).map(".".join)


@settings(
    max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(overrides=st.lists(st.tuples(keys, st.text(max_size=6) | values.map(repr)), max_size=3))
def test_overrides_of_any_kind(tmp_path, overrides):
    path = tmp_path / "e.toml"
    path.write_text(tomli_w.dumps(TREES["zhang2023_table_wrench"]))
    load_or_complain(path, tuple(f"{key}={value}" for key, value in overrides))
