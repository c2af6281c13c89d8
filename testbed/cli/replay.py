"""`testbed replay`: does today's code do what the log says was done?"""

import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from pathlib import Path

import msgspec
from msgspec.structs import replace
from rich.console import Console

from testbed.cli.main import FAILED, OK
from testbed.cli.refusal import refuse, warn
from testbed.config import ConfigError, Experiment, load
from testbed.flight.agent import lead_time
from testbed.flight.loop import HostNode
from testbed.logs.log_reader import LogError, LogReader, log_of
from testbed.logs.replay import (
    AtHost,
    LoggedHost,
    LoggedLink,
    Replay,
    before_damage,
    replay,
)
from testbed.rig.chain import make_agent, make_guidance


def config_of(run: Path) -> Path:
    """The experiment that a run folder, or the log in it, belongs to."""
    return (run if run.is_dir() else run.parent) / "config.toml"


def replay_run(run: Path, overrides: Sequence[str], as_json: bool) -> int:
    """Replay, say what came of it, and return the exit code."""
    try:
        log = log_of(run)
        with redirect_stdout(sys.stderr):  # what a law prints is not the result
            verdict = replay_experiment(load(config_of(run), overrides), log)
    except (ConfigError, LogError) as error:
        return refuse(error)
    if as_json:
        sys.stdout.write(msgspec.json.format(msgspec.json.encode(verdict)).decode() + "\n")
    else:
        _print(verdict)
    return OK if verdict.first_difference is None else FAILED


def replay_experiment(experiment: Experiment, log: Path) -> Replay:
    """The log through the agents and laws that the experiment makes today."""
    hosts = experiment.vehicles if experiment.deploy.law == "host" else {}
    book = LogReader(log)
    try:
        verdict = replay(
            before_damage(book),
            {name: make_agent(experiment, name).step for name in experiment.vehicles},
            {name: LoggedHost(_law_of(experiment, name)) for name in hosts},
        )
    finally:
        warn(book.said())
    return replace(verdict, whole=not book.lost)


def _law_of(experiment: Experiment, name: str) -> Callable[[LoggedLink], AtHost]:
    def plug(link: LoggedLink) -> AtHost:
        lead = lead_time(experiment.vehicles[name].model)
        guidance = make_guidance(experiment, name)
        return HostNode(name, guidance, link, experiment.flight.jet_period_s, lead).tick

    return plug


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
    out.print(f"  {first.field}: {first.logged!r} then, {first.now!r} now{size}", markup=False)
