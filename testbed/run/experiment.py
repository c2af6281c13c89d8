"""An experiment in Python: load it, and change it by key."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from testbed import config
from testbed.run.arguments import check_overrides, wrong


class Experiment(config.Experiment, frozen=True, forbid_unknown_fields=True):
    """A complete experiment; immutable, `with_` makes a changed copy."""

    def with_(self, changes: Mapping[str, Any] | None = None, **more: Any) -> "Experiment":
        """The same experiment with other values.

        Args:
            changes: values by dotted key, as on the command line: `{"controller.k": 0.3}`; `*` in
                a key means every entry.
            more: the same as keyword arguments: `**{"controller.k": 0.3}`, `seed=7`.

        Raises:
            TestbedError: a key does not exist, or a value is invalid.
        """
        overrides = texts_of("with_", changes, more)
        with told_by("with_"):
            return of(config.loads(tomli_w.dumps(config.dump(self)), overrides))

    def _repr_html_(self) -> str:
        return f"<pre>{self}</pre>"

    def __str__(self) -> str:
        vehicles = ", ".join(self.vehicles)
        return f"{self.name}, seed {self.seed}, {self.duration_s:g} s: {vehicles}"


def of(experiment: config.Experiment) -> Experiment:
    """The Python form of an experiment from a file."""
    return Experiment(**{f: getattr(experiment, f) for f in experiment.__struct_fields__})


def load(name_or_path: str | Path, *overrides: str, seed: int | None = None) -> Experiment:
    """Load an experiment.

    Args:
        name_or_path: the name of a shipped experiment (see `testbed list`), or the path of a file
            or of a run folder's config.toml.
        overrides: "key=value" as on the command line, applied in order; the value is TOML.
        seed: random seed of the twin.

    Raises:
        TestbedError: the file cannot be read, or it has an error.
    """
    check_overrides("testbed.load", overrides)
    texts = [*overrides, *([] if seed is None else [f"seed={toml(seed, 'testbed.load, seed')}"])]
    with told_by("testbed.load"):
        return of(config.load(config.find(str(name_or_path)), texts))


@contextmanager
def told_by(where: str) -> Iterator[None]:
    """Errors about overrides name a call in Python and not the command line."""
    try:
        yield
    except config.ConfigError as error:
        place = re.sub(r"(^|(?<= with ))command line", lambda found: where, error.where)
        if place == error.where:
            raise
        raise config.ConfigError(
            place, error.key, error.expected, error.found, error.hint
        ) from None


def texts_of(where: str, changes: Mapping[str, Any] | None, more: Mapping[str, Any]) -> list[str]:
    """Changes as overrides of the command line; `where` is the call that got them."""
    if not isinstance(changes, Mapping | None):
        raise wrong(where, 'values by key: {"controller.k": 0.3}', changes)
    values = {**(changes or {}), **more}
    return [f"{key}={toml(value, f'{where}, {key}')}" for key, value in values.items()]


def toml(value: Any, where: str = "value") -> str:
    """A Python value as TOML writes it; numpy's numbers and arrays too.

    Raises:
        TestbedError: TOML has no such value, as None; `where` is the argument.
    """
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, Path):
        value = str(value)
    if isinstance(value, Mapping):
        pairs = (f"{toml(str(k))} = {toml(v, f'{where}.{k}')}" for k, v in value.items())
        return "{" + ", ".join(pairs) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml(one, where) for one in value) + "]"
    try:
        return tomli_w.dumps({"value": value}).removeprefix("value = ").rstrip("\n")
    except TypeError:
        expected = "a number, text, true or false, list or table"
        raise wrong(where, expected, value) from None
