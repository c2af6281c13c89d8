"""A vehicle's chain and its law in a flight with forks: each stage goes on from the one before.

A change of gains in flight is a fork, too: `change` adds it to a flight that is on its way.
"""

from collections import deque
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import TypeVar

from controllers.own_law import OwnLawParams
from testbed.config import Experiment
from testbed.core.jets import JetHealth
from testbed.core.ports import HostLink
from testbed.core.types import Inputs, Outputs, Trajectory
from testbed.core.warned import Warned
from testbed.flight.agent import Agent, lead_time
from testbed.flight.flown_tick import AnyHostTick
from testbed.flight.guidance import Guidance, Kept
from testbed.flight.loop import HostNode
from testbed.rig.chain import make_agent, make_guidance, make_pilot

SOON = 1e-9  # ticks are products of periods [s]
Spoilt = Callable[[], str] | None
M = TypeVar("M")


def kept(before: Experiment, after: Experiment) -> Kept:
    """How much of the memory of its guidance a vehicle keeps."""
    one, other = before.controller, after.controller
    if before.guidance.mode != after.guidance.mode:
        return Kept.NOTHING
    if one == other:
        return Kept.LAW
    if isinstance(one, OwnLawParams) and isinstance(other, OwnLawParams):
        same = (one.law, one.sha256) == (other.law, other.sha256)
    else:
        same = type(one) is type(other)
    return Kept.STATE if same else Kept.MODEL


class ForkedAgent:
    """An agent, and those that take its place: (time [s], agent, what it keeps)."""

    def __init__(
        self, first: Agent, later: list[tuple[float, Agent, Kept]],
        make: Callable[[Experiment], Agent],
    ) -> None:  # fmt: skip
        self._now, self._later, self._make = first, deque(later), make

    def change(self, at_s: float, before: Experiment, after: Experiment) -> None:
        """Fly with `after` from the tick at `at_s` on.

        Raises:
            ValueError: its law cannot be made, or remembers more or less than before.
        """
        agent = self._make(after)
        agent.take_over(self._now, Kept.NOTHING)  # refused now, not in flight
        self._later.append((at_s, agent, kept(before, after)))

    def withdraw(self, at_s: float) -> None:
        """Take the newest change back, if it is for `at_s`."""
        withdraw(self._later, at_s)

    @property
    def guidance(self) -> Guidance | None:
        """The guidance, if the law runs on board."""
        return self._now.guidance

    def step(self, inputs: Inputs) -> Outputs:
        """See `Agent`."""
        while self._later and inputs.t >= self._later[0][0] - SOON:
            _, after, keeps = self._later.popleft()
            after.take_over(self._now, keeps)
            self._now = after
        return self._now.step(inputs)

    @property
    def jets(self) -> tuple[JetHealth, ...]:
        """See `Agent`."""
        return self._now.jets

    @property
    def warned(self) -> dict[str, Warned]:
        """See `Agent`."""
        return self._now.warned

    def staying(self, t: float) -> Trajectory | None:
        """See `Agent`."""
        return self._now.staying(t)


class ForkedHost(HostNode):
    """A law on the host, and those that take its place: (time [s], guidance, what it keeps)."""

    later: deque[tuple[float, Guidance, Kept]]
    make: Callable[[Experiment], Guidance]

    def change(self, at_s: float, before: Experiment, after: Experiment) -> None:
        """Fly with `after` from the tick at `at_s` on.

        Raises:
            ValueError: its law cannot be made.
        """
        self.later.append((at_s, self.make(after), kept(before, after)))

    def withdraw(self, at_s: float) -> None:
        """Take the newest change back, if it is for `at_s`."""
        withdraw(self.later, at_s)

    def take_over(self, t: float) -> None:
        """Go on with the newest guidance that is due."""
        while self.later and t >= self.later[0][0] - SOON:
            _, after, keeps = self.later.popleft()
            after.take_over(self.guidance, keeps)
            self.guidance = after

    def tick(self, t: float, armed: bool = True) -> AnyHostTick:
        """See `HostNode`."""
        self.take_over(t)
        return super().tick(t, armed)


def withdraw(later: deque[tuple[float, M, Kept]], at_s: float) -> None:
    """Take the newest change back, if it is for `at_s`."""
    if later and later[-1][0] == at_s:
        later.pop()


def make_vehicle(experiment: Experiment, name: str, spoilt: Spoilt = None) -> Agent | ForkedAgent:
    """One vehicle's flight chain.

    Raises:
        MismatchError: after a fork the chain would remember more or less than before.
    """
    agents = [make_agent(one, name, spoilt) for one in stages(experiment)]
    for after in agents[1:]:
        after.take_over(agents[0], Kept.NOTHING)  # refused now, not in flight
    if experiment.deploy.law == "host" and len(agents) == 1:
        return agents[0]
    make = partial(make_agent, name=name, spoilt=spoilt)
    return ForkedAgent(agents[0], _later(experiment, agents[1:]), make)


def make_host(
    experiment: Experiment, name: str, link: HostLink, spoilt: Spoilt = None,
    kind: type[ForkedHost] = ForkedHost,
) -> ForkedHost:  # fmt: skip
    """One vehicle's law on the host, and its pilot."""
    lead = lead_time(experiment.vehicles[name].model)
    first, *later = (make_guidance(one, name, spoilt) for one in stages(experiment))
    host = kind(
        name, first, link, experiment.flight.jet_period_s, lead, make_pilot(experiment, name)
    )
    host.later = deque(_later(experiment, later))
    host.make = partial(make_guidance, name=name, spoilt=spoilt)
    return host


def stages(experiment: Experiment) -> list[Experiment]:
    """The experiment, and after each fork."""
    return [experiment, *(after for _, after in experiment.stages())]


def _later(experiment: Experiment, made: list[M]) -> list[tuple[float, M, Kept]]:
    flown = stages(experiment)
    pairs = pairwise(flown)
    return [
        (fork.at_s, one, kept(*pair))
        for fork, one, pair in zip(experiment.forks, made, pairs, strict=True)
    ]
