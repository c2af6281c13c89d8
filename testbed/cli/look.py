"""Read-only verbs: `check`, `list`, `schema`."""

import sys
from collections.abc import Sequence, Sized
from pathlib import Path
from typing import Any, get_args

import msgspec
from rich.console import Console
from rich.table import Table as Grid

from controllers import catalogue
from testbed.cli.exit_code import OK
from testbed.cli.refusal import errors, refuse
from testbed.config import SHIPPED, ConfigError, Experiment, find, load, read_toml
from testbed.config.experiment import VehicleSetup
from testbed.config.guarantee import warnings_of
from testbed.config.hardware import WAYS, strength
from testbed.config.plausibility import doubts_of, quickest_s
from testbed.core.table import Table
from testbed.core.vehicle import Vehicle
from testbed.metrics.formation import has_formation


def check_experiment(name: str, overrides: Sequence[str]) -> int:
    """Print the content of an experiment, or the first error in it."""
    try:
        path = find(name)
        experiment = load(path, overrides)
    except ConfigError as error:
        return refuse(error)
    law = type(experiment.controller).__struct_config__.tag
    out = Console(highlight=False)
    out.print(
        f"ok: {path}\n"
        f"  {counted(experiment.vehicles, 'vehicle')}, "
        f"{counted(experiment.obstacles, 'obstacle')}, "
        f"law {law} in {experiment.guidance.mode} mode on the {experiment.deploy.law}, "
        f"{experiment.duration_s:g} s in {experiment.ticks} jet periods",
        markup=False, soft_wrap=True,
    )  # fmt: skip
    for name, setup in experiment.vehicles.items():
        out.print(f"  {name}: {abilities(experiment, setup)}", markup=False, soft_wrap=True)
    for warning in [*warnings_of(experiment), *doubts_of(experiment)]:
        errors.print(
            f"warning: {warning.name}: {warning.text}", style="yellow", markup=False, soft_wrap=True
        )
    return OK


def abilities(experiment: Experiment, setup: VehicleSetup) -> str:
    """Force, torque and acceleration of a vehicle, and its shortest time to the goal."""
    model, can = setup.model, strength(setup.model)
    force, torque = min(can[way] for way in WAYS[:4]), min(can[way] for way in WAYS[4:])
    words = (
        f"{counted(model.jets, 'jet')}, {force:.2f} N per axis, {torque:.3g} N m,"
        f" {force / model.mass:.2g} m/s^2"
    )
    if setup.path is not None or has_formation(experiment.controller):
        return words
    return f"{words}, at least {quickest_s(experiment, setup):.3g} s from start to goal"


def counted(things: Sized, word: str) -> str:
    """Count and noun, as in "1 vehicle" and "2 vehicles"."""
    return f"{len(things)} {word}{'s' * (len(things) != 1)}"


def _first_comment(path: Path) -> str:
    line = path.read_text(encoding="utf-8").partition("\n")[0]
    return line.removeprefix("#").strip()


def list_everything(as_json: bool) -> None:
    """Print shipped experiments, laws and vehicles."""
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
    vehicles = {
        p.stem: _first_comment(p)
        for p in sorted((SHIPPED / "vehicles").glob("*.toml"))
        if not p.is_symlink()
    }  # a link is an old name
    everything = {"experiments": experiments, "laws": laws, "vehicles": vehicles}
    if as_json:
        sys.stdout.write(msgspec.json.format(msgspec.json.encode(everything)).decode() + "\n")
        return
    out = Console(highlight=False)
    for title, entries in everything.items():
        grid = Grid.grid(padding=(0, 3))
        for name, line in entries.items():
            grid.add_row(f"  [bold]{name}[/]", line)
        out.print(f"{title}", style="bold cyan")
        out.print(grid)


def print_schema(kind: str) -> None:
    """Print the JSON Schema of experiment files, for editors."""
    types = {"experiment": Experiment, "vehicle": Vehicle, "table": Table}
    schema = msgspec.json.schema(types[kind])
    if kind == "experiment":
        definitions = schema["$defs"]
        _allow_path(definitions["Experiment"]["properties"], "table")
        _allow_path(definitions["VehicleSetup"]["properties"], "model")
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}
    sys.stdout.write(msgspec.json.format(msgspec.json.encode(schema)).decode() + "\n")


def _allow_path(properties: dict[str, Any], key: str) -> None:
    path = {"type": "string", "description": "path of a TOML file, relative to this one"}
    properties[key] = {"anyOf": [path, properties[key]]}
