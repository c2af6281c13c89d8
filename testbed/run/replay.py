"""A run's log through the agents and laws that its experiment makes today."""

from collections.abc import Callable
from pathlib import Path

from testbed.config import Experiment
from testbed.flight.agent import lead_time
from testbed.flight.loop import HostNode
from testbed.logs.log_reader import LogReader
from testbed.logs.replay import AtHost, LoggedHost, LoggedLink, Replay, replay
from testbed.rig.chain import make_agent, make_guidance


def replay_experiment(experiment: Experiment, log: Path) -> Replay:
    """The log through the agents and laws that the experiment makes today."""
    hosts = experiment.vehicles if experiment.deploy.law == "host" else {}
    return replay(
        LogReader(log).read(),
        {name: make_agent(experiment, name).step for name in experiment.vehicles},
        {name: LoggedHost(_law_of(experiment, name)) for name in hosts},
    )


def _law_of(experiment: Experiment, name: str) -> Callable[[LoggedLink], AtHost]:
    def plug(link: LoggedLink) -> AtHost:
        lead = lead_time(experiment.vehicles[name].model)
        guidance = make_guidance(experiment, name)
        return HostNode(name, guidance, link, experiment.flight.jet_period_s, lead).tick

    return plug
