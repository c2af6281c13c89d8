"""`testbed commission`: from an assembled vehicle to its first float, step by step."""

import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from datetime import date
from pathlib import Path

import click
from rich.console import Console

from firmware_interface.limits import LimitsError, limits_of
from testbed.cli.exit_code import FAILED, FAULT, INTERRUPTED, OK
from testbed.cli.poses import cameras
from testbed.cli.refusal import errors, refuse
from testbed.cli.screen import print_text
from testbed.commission.procedure import Commissioned, commission
from testbed.commission.report import lines_of, passed, write_report
from testbed.commission.station import Station
from testbed.commission.twin_station import TwinStation
from testbed.commission.verdict import Verdict
from testbed.commission.wired_station import WiredStation
from testbed.config import ConfigError, Experiment, find, load
from testbed.core.error import TestbedError
from testbed.net.session import NetworkError
from testbed.rig.commissioning import record_of, save
from testbed.run.folder import FolderError, new_folder, take_back

screen = Console(highlight=False)


def run_commission(
    name: str, overrides: Sequence[str], rig: str, only: Sequence[str], out: Path | None, *,
    yes: bool, as_json: bool,
) -> int:  # fmt: skip
    """Commission the vehicles; returns the exit code."""
    with ExitStack() as stack:
        try:
            experiment = load(find(name), overrides)
            names = _chosen(experiment, only, rig, yes=yes)
            agree = None if yes or not sys.stdin.isatty() else _may
            station, experiment = _station(experiment, names, rig, stack, agree)
            folder = new_folder(out, f"commission_{experiment.name}")
        except (ConfigError, FolderError, LimitsError) as error:
            return refuse(error)
        except (NetworkError, TestbedError, OSError) as error:
            return refuse(error, FAULT)
        try:
            done = commission(experiment, station, _nothing if as_json else _print_verdict, names)
        except TestbedError as error:  # a board or a line failed
            return refuse(error, FAULT)
        except KeyboardInterrupt:
            print_text(errors, "interrupted: the vehicles are not commissioned", "yellow")
            take_back(folder)
            return INTERRUPTED
        write_report(folder, experiment, done, rig)
    good = [one for one in names if passed(done.verdicts, one)]
    if rig == "table":
        for one in good:
            board = next(v.text for v in done.verdicts if (v.step, v.vehicle) == ("board", one))
            day = date.today().isoformat()
            kept = save(experiment, one, record_of(experiment, one, board, day, str(folder)))
            errors.print(f"record for arming: {kept}", markup=False, soft_wrap=True)
    if as_json:
        sys.stdout.write((folder / "commission.json").read_text())
    else:
        _end(done, names, good, folder)
    wrong = any(v.code for v in done.verdicts)
    return FAILED if wrong or (rig == "table" and len(good) < len(names)) else OK


def _chosen(experiment: Experiment, only: Sequence[str], rig: str, *, yes: bool) -> list[str]:
    unknown = [one for one in only if one not in experiment.vehicles]
    if unknown:
        expected = f"one of: {', '.join(experiment.vehicles)}"
        raise ConfigError("command line", "--vehicle", expected, unknown[0])
    if rig == "table" and (yes or not sys.stdin.isatty()):
        found = "--yes" if yes else "no terminal"
        expected = "a person at a terminal who watches the vehicle"
        raise ConfigError("command line", "--rig table", expected, found)
    for one in only or experiment.vehicles:
        limits_of(experiment.vehicles[one].model)  # a board can drive its jets
    return list(only or experiment.vehicles)


def _station(
    experiment: Experiment,
    names: Sequence[str],
    rig: str,
    stack: ExitStack,
    agree: Callable[[str], bool] | None,
) -> tuple[Station, Experiment]:
    if rig == "twin":
        return TwinStation(experiment, agree=agree), experiment
    if rig == "bench":
        from testbed.rig.wired.twin_child import twin_child

        experiment = stack.enter_context(twin_child(experiment))
    source = cameras(experiment, stack)
    stack.callback(source.close)
    person = _ask if rig == "table" else None
    station = WiredStation(experiment, names, source, stack, person, agree)
    if rig == "bench":  # its plant starts when every vehicle floats
        for on in (True, False):
            for one in names:
                station.bearing(one, on=on)
            station.wait(0.3)
    return station, experiment


def _ask(question: str) -> bool:
    return click.confirm(question, default=False, err=True)


def _may(what: str) -> bool:
    return _ask(f"{what}. May it?")


def _nothing(_: Verdict) -> None:
    """Print nothing."""


def _print_verdict(verdict: Verdict) -> None:
    for line in lines_of([verdict]):
        print_text(screen, line, "red" if verdict.code else None, len(line) - len(verdict.text))


def _end(done: Commissioned, names: Sequence[str], good: Sequence[str], folder: Path) -> None:
    for one in names:
        wrong = [v.step for v in done.verdicts if v.vehicle == one and v.code]
        left = [v.step for v in done.verdicts if v.vehicle == one and v.skipped]
        if one in good:
            text = f"{one}: commissioned; its measured file is {folder / one}.toml"
        elif wrong:
            text = f"{one}: not commissioned; mend what is wrong at: {', '.join(wrong)}"
        else:
            text = f"{one}: nothing wrong, but left out: {', '.join(left)}"
        print_text(screen, text)
    print_text(screen, f"report: {folder / 'commission.txt'}")
