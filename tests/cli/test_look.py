"""`testbed check`, `list`, `schema` and `--help`."""

import json
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import tomli_w

from testbed.config import SHIPPED, dump, find, load

EXPERIMENTS = sorted((SHIPPED / "experiments").glob("*.toml"))
HEAVY = {"numpy", "scipy", "numba", "rich", "msgspec", "mcap", "tomli_w"}


# check


@pytest.mark.parametrize("path", EXPERIMENTS, ids=lambda path: path.stem)
def test_every_shipped_experiment_is_valid(testbed, path):
    for name in (path, path.stem):
        result = testbed("check", name)
        assert result.exit_code == 0
        assert result.stdout.startswith(f"ok: {path}\n")
        assert all(line.startswith("warning: ") for line in result.stderr.splitlines())


def test_check_says_what_is_in_it(testbed):
    result = testbed("check", "zhang2023_table", "duration_s=20", "deploy.law=vehicle")
    words = "3 vehicles, 2 obstacles, law sotsmc in reference mode on the vehicle, 20 s in 200 jet periods"  # noqa: E501
    assert words in result.stdout


def test_check_writes_nothing(testbed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    testbed("check", "hold")
    assert list(tmp_path.iterdir()) == []


# list


def test_list_names_everything(testbed):
    result = testbed("list")
    assert result.exit_code == 0
    for name in [path.stem for path in EXPERIMENTS] + ["sotsmc", "smc", "pd", "generic_8jet"]:
        assert name in result.stdout
    assert "\x1b" not in result.stdout


def test_list_as_json(testbed):
    everything = json.loads(testbed("list", "--json").stdout)
    assert list(everything["experiments"]) == [path.stem for path in EXPERIMENTS]
    assert set(everything["laws"]) >= {"sotsmc", "smc", "pd"}
    assert everything["tables"].keys() >= {"marble_6m", "rough_6m"}
    assert all(load(path) for path in map(Path, everything["scenarios"]))
    assert all(line for kind in everything.values() for line in kind.values())


# schema


def violations(
    schema: dict[str, Any], value: Any, whole: dict[str, Any], at: str = "$"
) -> list[str]:
    """What is wrong with `value`, by the part of JSON Schema that msgspec writes."""
    if "$ref" in schema:
        return violations(whole["$defs"][schema["$ref"].removeprefix("#/$defs/")], value, whole, at)
    if "anyOf" in schema:
        options = [violations(option, value, whole, at) for option in schema["anyOf"]]
        return [] if [] in options else min(options, key=len)
    kinds = {"object": dict, "array": list, "string": str, "boolean": bool, "integer": int,
             "number": (int, float), "null": type(None)}  # fmt: skip
    kind = schema.get("type")
    if kind and (not isinstance(value, kinds[kind]) or (kind != "boolean" and value is True)):
        return [f"{at}: not {kind}"]
    if "enum" in schema and value not in schema["enum"]:
        return [f"{at}: not one of {schema['enum']}"]
    found = []
    for rule, broken in {
        "minimum": lambda bound: value < bound,
        "maximum": lambda bound: value > bound,
        "exclusiveMinimum": lambda bound: value <= bound,
        "exclusiveMaximum": lambda bound: value >= bound,
        "minItems": lambda bound: len(value) < bound,
        "maxItems": lambda bound: len(value) > bound,
    }.items():
        if rule in schema and broken(schema[rule]):
            found.append(f"{at}: {rule}")
    if kind == "object":
        known, others = schema.get("properties", {}), schema.get("additionalProperties", True)
        found += [
            f"{at}.{name}: missing" for name in schema.get("required", []) if name not in value
        ]
        for name, item in value.items():
            if others is False and name not in known:
                found.append(f"{at}.{name}: unknown")
            elif isinstance(rule := known.get(name, others), dict):
                found += violations(rule, item, whole, f"{at}.{name}")
    if kind == "array":
        first = schema.get("prefixItems", [])
        rest = schema.get("items", {})
        for i, item in enumerate(value):
            rule = first[i] if i < len(first) else rest
            found += violations(rule or {}, item, whole, f"{at}[{i}]")
    return found


@pytest.fixture
def schema_of(testbed):
    def read(*kind: str) -> dict[str, Any]:
        result = testbed("schema", *kind)
        assert result.exit_code == 0
        assert result.stderr == ""
        return json.loads(result.stdout)

    return read


@pytest.mark.parametrize("path", EXPERIMENTS, ids=lambda path: path.stem)
def test_shipped_experiments_fit_the_schema(schema_of, path):
    schema = schema_of()
    assert violations(schema, tomllib.loads(path.read_text()), schema) == []
    resolved = tomllib.loads(tomli_w.dumps(dump(load(path))))
    assert violations(schema, resolved, schema) == []


@pytest.mark.parametrize("kind", ["vehicle", "table"])
def test_shipped_parts_fit_their_schema(schema_of, kind):
    schema = schema_of(kind)
    for path in (SHIPPED / f"{kind}s").glob("*.toml"):
        assert violations(schema, tomllib.loads(path.read_text()), schema) == []


@pytest.mark.parametrize(
    ("change", "violation"),
    [
        ({"nmae": "x"}, "$.nmae: unknown"),
        ({"duration_s": 0}, "$.duration_s: exclusiveMinimum"),
        ({"duration_s": "long"}, "$.duration_s: not number"),
        ({"seed": -1}, "$.seed: minimum"),
        ({"vehicles": {"a": {"start": [0] * 3, "goal": [0] * 3}}}, "$.vehicles.a.model: missing"),
        ({"guidance": {"mode": "x"}}, "$.guidance.mode: not one of ['reference', 'wrench']"),
        ({"deploy": {"law": 3}}, "$.deploy.law: not one of ['host', 'vehicle']"),
        ({"obstacles": {"o": {"position": [1], "radius": 1}}}, "$.obstacles.o.position: minItems"),
    ],
)  # fmt: skip
def test_the_schema_finds_mistakes(schema_of, change, violation):
    schema = schema_of()
    tree = tomllib.loads(find("hold").read_text()) | change
    assert violations(schema, tree, schema) == [violation]


def test_the_schema_knows_every_law_by_its_type(schema_of):
    schema = schema_of()
    tree = tomllib.loads(find("hold").read_text())
    for law in ("sotsmc", "smc", "pd"):
        assert violations(schema, tree | {"controller": {"type": law}}, schema) == []
    assert violations(schema, tree | {"controller": {"type": "pid"}}, schema)
    assert violations(schema, tree | {"controller": {}}, schema)


@pytest.mark.parametrize("kind", ["experiment", "vehicle", "table"])
def test_every_definition_of_a_schema_says_what_it_is(schema_of, kind):
    schema = schema_of(kind)
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    assert all(d.get("description") for d in schema["$defs"].values() if d["type"] == "object")


# help


@pytest.mark.parametrize("words", [["--help"], ["--version"], ["run", "--help"], ["nonsense"]])
def test_help_imports_nothing_heavy(words):
    script = (
        "import sys; from testbed.cli.main import main\n"
        "try: main(sys.argv[1:])\n"
        "except SystemExit: pass\n"
        "print('MODULES', *sorted(sys.modules))"
    )
    result = subprocess.run(
        [sys.executable, "-c", script, *words], capture_output=True, text=True, check=True
    )
    loaded = result.stdout.partition("MODULES ")[2].split()
    assert HEAVY & {name.partition(".")[0] for name in loaded} == set()
    assert "click" in loaded


@pytest.mark.parametrize("words", [["check", "zhang2023_table"], ["check", "hold"]])
def test_loading_an_experiment_imports_no_large_parts_of_scipy(words):
    script = (
        "import sys; from testbed.cli.main import main\n"
        "try: main(sys.argv[1:])\n"
        "except SystemExit: pass\n"
        "import testbed.cli.run; print('MODULES', *sorted(sys.modules))"
    )
    result = subprocess.run(
        [sys.executable, "-c", script, *words], capture_output=True, text=True, check=True
    )
    loaded = result.stdout.partition("MODULES ")[2].split()
    assert {"scipy.optimize", "scipy.spatial", "scipy.stats"}.isdisjoint(loaded)


def test_help_names_every_verb_and_the_form_of_an_override(testbed):
    result = testbed("--help")
    for verb in ("run", "check", "list", "schema"):
        assert f"  {verb} " in result.stdout
    text = testbed("run", "--help").stdout
    assert "vehicles.sat1.start=[1.2,-1.4,0.0]" in text
    assert "[default: runs/<UTC time>_<name>]" in " ".join(text.split())


def test_help_examples_are_valid(testbed):
    lines = testbed("run", "--help").stdout.splitlines()
    examples = [shlex.split(line) for line in lines if line.strip().startswith("testbed run ")]
    assert len(examples) == 3
    for _, _, experiment, *words in examples:
        overrides = [word for word in words if "=" in word]
        assert testbed("check", experiment, *overrides).exit_code == 0


def test_where_is_here(testbed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = Path("mine.toml")
    path.write_text(tomli_w.dumps(dump(load(find("hold")))))
    assert testbed("check", path).stdout.startswith("ok: mine.toml\n")
