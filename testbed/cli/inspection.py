"""Read-only verbs: `check`, `list`, `schema`."""

import re
import sys
from collections.abc import Sequence
from itertools import takewhile
from pathlib import Path
from typing import Any, get_args

import msgspec
from rich.console import Console
from rich.table import Table as Grid

from controllers import catalogue
from testbed.cli.exit_code import OK
from testbed.cli.refusal import errors, refuse
from testbed.cli.screen import print_json, print_text, show
from testbed.config import SHIPPED, ConfigError, Experiment, find, load, read_toml
from testbed.config.capability import abilities
from testbed.config.file import fault_texts, words_for
from testbed.config.fit import defaults_of
from testbed.config.guarantee import warnings_of
from testbed.config.key import spell
from testbed.config.law_demand import asks_too_much
from testbed.config.plausibility import doubts_of
from testbed.config.thresholds import WORDS, words_in, worked_out
from testbed.config.unmeasured import never_measured
from testbed.core.spelling import counted
from testbed.core.table import Table
from testbed.core.vehicle import Vehicle


def check_experiment(
    name: str, overrides: Sequence[str], *, faults: bool = False, defaults: bool = False
) -> int:
    """Print the content of an experiment, or the first error in it."""
    try:
        path = find(name)
        experiment = load(path, overrides)
    except ConfigError as error:
        return refuse(error)
    law = type(experiment.controller).__struct_config__.tag
    out = Console(highlight=False)
    out.print(f"ok: {path}", markup=False, soft_wrap=True)
    print_text(
        out,
        f"  {counted(len(experiment.vehicles), 'vehicle')}, "
        f"{counted(len(experiment.obstacles), 'obstacle')}, "
        f"law {law} in {experiment.guidance.mode} mode on the {experiment.deploy.law}, "
        f"{experiment.duration_s:g} s in {experiment.ticks} jet periods",
    )
    for name in experiment.vehicles:
        first, *rest = abilities(experiment, name)
        for line in (f"{name}: {first}", *rest):
            print_text(out, f"  {line}")
    if defaults:
        print_defaults(experiment, out)
    if faults:
        print_faults(path, experiment, overrides, out)
    found = [
        *warnings_of(experiment), *asks_too_much(experiment), *never_measured(experiment),
        *doubts_of(experiment),
    ]  # fmt: skip
    for warning in found:
        print_text(errors, f"warning: {warning.name}: {warning.text}", "yellow")
    return OK


def print_faults(
    path: Path, experiment: Experiment, overrides: Sequence[str], out: Console
) -> None:
    """Print each row of the fault table, and the arithmetic of its bound."""
    texts, words = fault_texts(path, overrides), words_for(experiment)
    for name, row in experiment.faults.items():
        bound = "above" if row.above is not None else "below"
        text = texts.get((name, bound))
        how = f" = {worked_out(text, words)}" if text else ""
        holds = [f"{row.misses} times in a row"] * (row.misses > 1)
        holds += [f"for {row.timeout_s:g} s"] * (row.timeout_s > 0.0)
        print_text(
            out,
            f"  {name}: {row.detector} {bound} {getattr(row, bound):.4g}"
            f"{''.join(f', {one}' for one in holds)}: {row.response}"
            f"{f', else {row.otherwise}' * row.reconfigures}{how}",
        )
    names = sorted({one for text in texts.values() for one in words_in(text)})
    for one in names:
        print_text(out, f"  {one}: {WORDS[one]}")


def print_defaults(given: Experiment, out: Console) -> None:
    """Print each default that follows from the vehicles and the table, and its arithmetic."""
    for key, value, how in defaults_of(given):
        own = given
        for part in key:
            own = getattr(own, str(part))
        differs = "" if own == value else f"; the file has {own:.4g}"
        print_text(out, f"  {spell(key)} {value:.4g}: {how}{differs}")


def _first_comment(path: Path) -> str:
    """The first sentence of the comment at the head of a file."""
    lines = takewhile(lambda line: line[:1] == "#", path.read_text(encoding="utf-8").splitlines())
    whole = " ".join(line.removeprefix("#").strip() for line in lines)
    return re.split(r"(?<=[a-z0-9)])\.(?= |$)", whole, maxsplit=1)[0]


def _first_comments(kind: str) -> dict[str, str]:
    return {
        path.stem: _first_comment(path)
        for path in sorted((SHIPPED / kind).glob("*.toml"))
        if not path.is_symlink()  # a link is an old name
    }


def _path_from_here(path: Path) -> str:
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)


def list_everything(as_json: bool) -> None:
    """Print shipped experiments, laws, vehicles, tables, and scenarios with their paths."""
    experiments = {
        path.stem: str(read_toml(path).get("description", ""))
        for path in sorted((SHIPPED / "experiments").glob("*.toml"))
    }
    laws = {
        str(kind.__struct_config__.tag): (sys.modules[kind.__module__].__doc__ or "").partition(
            "\n"
        )[0]
        for kind in get_args(catalogue.Controller)
    }
    everything = {
        "experiments": experiments,
        "laws": laws,
        "vehicles": _first_comments("vehicles"),
        "tables": _first_comments("tables"),
        "scenarios": {
            _path_from_here(path): _first_comment(path)
            for path in sorted((SHIPPED / "scenarios").glob("*.toml"))
        },
    }
    if as_json:
        print_json(everything)
        return
    out = Console(highlight=False)
    for title, entries in everything.items():
        grid = Grid.grid(padding=(0, 3))
        for name, line in entries.items():
            grid.add_row(f"  [bold]{name}[/]", line)
        by_path = ", by their paths" if title == "scenarios" else ""
        out.print(f"{title}{by_path}", style="bold cyan")
        show(out, grid)


def print_schema(kind: str) -> None:
    """Print the JSON Schema of experiment files, for editors."""
    types = {"experiment": Experiment, "vehicle": Vehicle, "table": Table}
    schema = msgspec.json.schema(types[kind])
    if kind == "experiment":
        definitions = schema["$defs"]
        _allow_path(definitions["Experiment"]["properties"], "table")
        _allow_path(definitions["VehicleSetup"]["properties"], "model")
        for bound in ("above", "below"):
            text = {"type": "string", "description": "arithmetic of vehicle and table"}
            definitions["Fault"]["properties"][bound]["anyOf"].append(text)
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}
    print_json(schema)


def _allow_path(properties: dict[str, Any], key: str) -> None:
    meaning = "path of a TOML file, relative to this one, or the name of a shipped file"
    path = {"type": "string", "description": meaning}
    properties[key] = {"anyOf": [path, properties[key]]}
