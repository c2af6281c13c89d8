"""Replays a run's log through the current agents and laws of its experiment."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from msgspec.structs import replace

from testbed.config import Experiment
from testbed.core.types import HostTick
from testbed.logs.log_reader import LogReader
from testbed.logs.replay import AtHost, LoggedHost, LoggedLink, Replay, before_damage, replay
from testbed.rig.forked import make_host, make_vehicle
from testbed.run.missing_parts import is_whole, lacks, metrics_of
from testbed.run.recorded import check_flight


def replay_experiment(
    experiment: Experiment, log: Path, warn: Callable[[list[str]], None] = lambda lines: None
) -> Replay:
    """Replay a log through the current agents and laws of an experiment.

    Args:
        experiment: defines the agents and laws.
        log: log of a run.
        warn: called with a line for each part of the log that is missing.

    Raises:
        LogError: the log has no ticks, or is not of this experiment.
    """
    hosts = experiment.vehicles if experiment.deploy.law == "host" else {}
    book = LogReader(log)
    try:
        verdict = replay(
            before_damage(book),
            {name: make_vehicle(experiment, name).step for name in experiment.vehicles},
            {name: LoggedHost(partial(_law_of, experiment, name)) for name in hosts},
        )
    finally:
        warn(lacks(book))
    check_flight(book, metrics_of(log.parent))
    return replace(verdict, whole=is_whole(book))


def _law_of(experiment: Experiment, name: str, link: LoggedLink) -> AtHost:
    host = make_host(experiment, name, link)

    def tick(t: float) -> HostTick:
        assert link.inputs is not None
        host.stick = link.inputs.stick
        again = host.tick(t)
        assert isinstance(again, HostTick)
        return again

    return tick
