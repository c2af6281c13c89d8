"""Injected faults of a law and of a vehicle's process, on any rig.

The twin injects faults of cameras, air and boards; these wrappers are added in `rig/chain.py` and
`rig/twin.py`.
"""

from collections.abc import Callable

import numpy as np

from testbed.core.codes import FaultReport, InhibitReason, Refusal
from testbed.core.error import TestbedError
from testbed.core.jets import JetHealth
from testbed.core.law import Ahead, Array, Body, Concern, Law, Neighbours, World, concerns_of
from testbed.core.types import Health, Inputs, Outputs, Tick, ValveCommand, Vitals, Wrench
from testbed.core.warned import Warned
from testbed.flight.guidance import Guidance
from testbed.flight.loop import VehicleNode


class InjectedFaultError(TestbedError):
    """The error that an injected fault raises in a law."""


class SpoiltLaw:
    """A law that returns nan or raises when `spoilt()` returns "nan" or "raise"."""

    def __init__(self, law: Law, spoilt: Callable[[], str]) -> None:
        self._law, self._spoilt, self.message_size = law, spoilt, law.message_size

    def concerns(self, law_state: Array) -> list[Concern]:
        """See `Law`."""
        return concerns_of(self._law, law_state)

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
            raise InjectedFaultError("as injected")
        ahead = self._law.propagate(law_state, own, neighbours, world, t, duration, steps)
        if what == "nan":
            none = np.full(len(ahead.p), np.nan)
            ahead = Ahead(ahead.law_state, none, none, none, ahead.message)
        return ahead


class CrashableNode:
    """A vehicle's node whose process may die: then it neither receives nor acts."""

    def __init__(self, node: VehicleNode, jets: int, dead: Callable[[], bool]) -> None:
        self.name = node.name
        self._node, self._dead, self._shut = node, dead, (0,) * jets

    @property
    def guidance(self) -> Guidance | None:
        """See `VehicleNode`."""
        return self._node.guidance

    @property
    def jets(self) -> tuple[JetHealth, ...]:
        """See `VehicleNode`."""
        return self._node.jets

    @property
    def warned(self) -> dict[str, Warned]:
        """See `Agent`."""
        return self._node.warned

    def tick(
        self, t: float, armed: bool, fleet: FaultReport | None = None, *,
        end: bool = False, stay: bool = False,
    ) -> Tick:  # fmt: skip
        """The node's tick, or a tick without state if the process is dead."""
        if not self._dead():
            return self._node.tick(t, armed, fleet, end=end, stay=stay)
        still, command = Wrench(0.0, 0.0, 0.0), ValveCommand(0, t, t, self._shut, self._shut)
        inputs = Inputs(t, armed, (), None, {}, Health(t, 0.0, 0.0), vitals=Vitals(end=end))
        dead = Refusal(InhibitReason.PROCESS_DEAD)
        return Tick(inputs, Outputs(t, None, None, still, still, command, dead))
