"""What a rehearsed fault does to a law and to a process, on any rig.

The twin breaks cameras, air and boards itself; these two stand where the stack is put together.
"""

from collections.abc import Callable

import numpy as np

from testbed.core.error import TestbedError
from testbed.core.law import Ahead, Array, Body, Concern, Law, Neighbours, World
from testbed.core.types import Health, Inputs, Outputs, Tick, ValveCommand, Vitals, Wrench
from testbed.flight.guidance import Guidance
from testbed.flight.loop import VehicleNode


class SabotageError(TestbedError):
    """What a law raises when it is told to."""


class SpoiltLaw:
    """A law that goes wrong when `spoilt()` says so: "nan" or "raise"."""

    def __init__(self, law: Law, spoilt: Callable[[], str]) -> None:
        self._law, self._spoilt, self.message_size = law, spoilt, law.message_size

    def concerns(self, law_state: Array) -> list[Concern]:
        """What the law itself has to say of the flight."""
        say = getattr(self._law, "concerns", None)
        return [] if say is None else list(say(law_state))

    def initial(self, own: Body, neighbours: Neighbours, world: World) -> Array:
        """See `Law`."""
        return self._law.initial(own, neighbours, world)

    def rate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World, t: float
    ) -> tuple[Array, Array]:
        """See `Law`."""
        return self._law.rate(law_state, own, neighbours, world, t)

    def propagate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World,
        t: float, duration: float, steps: int,
    ) -> Ahead:  # fmt: skip
        """See `Law`."""
        what = self._spoilt()
        if what == "raise":
            raise SabotageError("as injected")
        ahead = self._law.propagate(law_state, own, neighbours, world, t, duration, steps)
        if what == "nan":
            none = np.full(len(ahead.p), np.nan)
            ahead = Ahead(ahead.law_state, none, none, none, ahead.message)
        return ahead


class CrashableNode:
    """A vehicle's node whose process may die: then it neither listens nor acts."""

    def __init__(self, node: VehicleNode, jets: int, dead: Callable[[], bool]) -> None:
        self.name = node.name
        self._node, self._dead, self._shut = node, dead, (0,) * jets

    @property
    def guidance(self) -> Guidance | None:
        """See `VehicleNode`."""
        return self._node.guidance

    def tick(self, t: float, armed: bool, fleet: str = "", end: str = "") -> Tick:
        """The node's own tick, or what a log says of a process that is gone."""
        if not self._dead():
            return self._node.tick(t, armed, fleet, end)
        still, command = Wrench(0.0, 0.0, 0.0), ValveCommand(0, t, t, self._shut, self._shut)
        inputs = Inputs(t, armed, (), None, {}, Health(t, 0.0, 0.0), vitals=Vitals(end=end))
        return Tick(inputs, Outputs(t, None, None, still, still, command, "its process is dead"))
