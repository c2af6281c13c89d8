"""`testbed replay`: today's code on the inputs of a log, or on from one of its ticks."""

import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from pathlib import Path

from rich.console import Console

from testbed.cli.exit_code import FAILED, INTERRUPTED, OK
from testbed.cli.refusal import refuse, warn
from testbed.cli.result import code_of, print_result
from testbed.cli.screen import print_json
from testbed.config import ConfigError, load
from testbed.core.error import TestbedError
from testbed.logs.log_reader import LogError, config_of, log_of
from testbed.logs.replay import Replay
from testbed.run.api import InterruptedFlight, fly_on, read_folder
from testbed.run.replay import replay_experiment


def replay_run(run: Path, overrides: Sequence[str], as_json: bool) -> int:
    """Replay and print the verdict; return the exit code."""
    try:
        log = log_of(run)
        with redirect_stdout(sys.stderr):  # keeps a law's prints out of the result
            verdict = replay_experiment(load(config_of(run), overrides), log, warn)
    except (ConfigError, LogError) as error:
        return refuse(error)
    if as_json:
        print_json(verdict)
    else:
        _print(verdict)
    return OK if verdict.first_difference is None else FAILED


def _print(verdict: Replay) -> None:
    out, first = Console(highlight=False), verdict.first_difference
    if first is None:
        part = "" if verdict.whole else ", up to the damage"
        out.print(f"[bold green]bit-exact[/]: {verdict.ticks} ticks{part}")
        return
    out.print(
        f"[bold red]different[/] ({verdict.ticks} ticks), first at tick "
        f"{first.tick}, t = {first.t:.3f} s, {first.topic}, {first.stage}"
    )
    size = "" if first.size is None else f", off by {first.size:.3g}"
    out.print(
        f"  {first.field}: logged {first.logged!r}, now {first.now!r}{size}",
        markup=False, soft_wrap=True,
    )  # fmt: skip


def fork_run(
    run: Path, since: float, overrides: Sequence[str], out: Path | None, as_json: bool
) -> int:
    """Fly a run again up to a time and on with overrides; return the exit code."""
    try:
        with redirect_stdout(sys.stderr):  # keeps a law's prints out of the result
            original = read_folder(run)
            warn(original.damage)
            flown = fly_on(original, since, *overrides, log=out, option="--out")
    except InterruptedFlight as interrupted:
        flown = interrupted.run
    except TestbedError as error:
        return refuse(error)
    if flown.folder is None:
        return INTERRUPTED
    if as_json:
        sys.stdout.write((flown.folder / "metrics.json").read_text())
    else:
        print_result(flown.metrics, flown.experiment, flown.folder)
    return code_of(flown.metrics)
