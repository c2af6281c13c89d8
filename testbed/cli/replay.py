"""`testbed replay`: compare the outputs of the current code with those in a log."""

import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from pathlib import Path

import msgspec
from rich.console import Console

from testbed.cli.exit_code import FAILED, OK
from testbed.cli.refusal import refuse, warn
from testbed.config import ConfigError, load
from testbed.logs.log_reader import LogError, config_of, log_of
from testbed.logs.replay import Replay
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
        sys.stdout.write(msgspec.json.format(msgspec.json.encode(verdict)).decode() + "\n")
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
        f"{first.tick}, t = {first.t:.3f} s, {first.topic}"
    )
    size = "" if first.size is None else f", off by {first.size:.3g}"
    out.print(f"  {first.field}: logged {first.logged!r}, now {first.now!r}{size}", markup=False)
