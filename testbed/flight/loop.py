"""The loop that flies an experiment, the same on every rig.

Tick k is due at k * period of the clock it is handed. In each tick every vehicle takes its step
first, on what has arrived so far; then the host answers for the next one.
"""

from collections.abc import Callable, Sequence
from typing import Protocol

from msgspec import Struct

from testbed.core.ports import Clock, HostLink, PoseSource, Thrusters, VehicleLink
from testbed.core.types import HostInputs, HostOutputs, HostTick, Inputs, Tick
from testbed.flight.agent import Agent
from testbed.flight.guidance import Guidance


class VehicleNode:
    """An agent and the ports it is plugged into."""

    def __init__(
        self, name: str, agent: Agent, poses: PoseSource, thrusters: Thrusters, link: VehicleLink
    ) -> None:
        self.name = name
        self._agent, self._poses, self._thrusters, self._link = agent, poses, thrusters, link

    @property
    def guidance(self) -> Guidance | None:
        """The law at work, if it runs on board."""
        return self._agent.guidance

    def tick(self, t: float, armed: bool) -> Tick:
        """Listen, step, act, tell."""
        link = self._link
        inputs = Inputs(
            t,
            armed,
            tuple(self._poses.samples()),
            link.setpoint(),
            link.neighbours() if self._agent.hears_neighbours else {},
            self._thrusters.health(),
            link.told() if self._agent.hears_neighbours else {},
        )
        outputs = self._agent.step(inputs)
        self._thrusters.apply(outputs.command)
        if outputs.state is not None:
            link.publish(outputs.state)
        if outputs.told is not None:
            link.tell(outputs.told)
        return Tick(inputs, outputs)


class HostNode:
    """One vehicle's law on the host.

    What it sends at a tick reaches the vehicle before its next one, so it is meant for the jet
    period after the coming one.
    """

    def __init__(
        self, name: str, guidance: Guidance, link: HostLink, period: float, lead: float
    ) -> None:
        self.name, self.guidance, self._link = name, guidance, link
        self._ahead = period + lead

    def tick(self, t: float) -> HostTick:
        """Listen, step, tell."""
        link, guidance = self._link, self.guidance
        inputs = HostInputs(t, link.own(), link.neighbours(), link.told())
        if inputs.own is None:
            return HostTick(inputs, HostOutputs(t, None))
        setpoint = guidance.step(t + self._ahead, inputs.own, inputs.neighbours, inputs.told)
        link.publish(setpoint)
        if guidance.told is not None:
            link.tell(guidance.told)
        return HostTick(inputs, HostOutputs(t, setpoint, guidance.told))


class Observer(Protocol):
    """Whoever watches: recorder, progress bar, dashboard. Must not slow the loop down."""

    def vehicle(self, name: str, tick: Tick) -> None:
        """One vehicle's tick."""
        ...

    def host(self, name: str, tick: HostTick) -> None:
        """One vehicle's law on the host."""
        ...

    def done(self, t: float) -> None:
        """All of them are through with the tick at `t`."""
        ...


class Ending(Struct, frozen=True):
    """How a flight ended."""

    t: float  # [s]
    fault: str | None  # None: flown to the end


def fly(
    clock: Clock,
    vehicles: Sequence[VehicleNode],
    hosts: Sequence[HostNode],
    period: float,
    ticks: int,
    observer: Observer,
    *,
    stopped: Callable[[], bool] = lambda: False,
) -> Ending:
    """Fly `ticks` jet periods, or until a gate latches a fault or `stopped()` says so."""
    fault, stop = None, False
    for k in range(ticks):
        t = k * period
        clock.wait_until(t)
        armed = fault is None and not stop
        for node in vehicles:
            tick = node.tick(t, armed)
            observer.vehicle(node.name, tick)
            if tick.outputs.fault and fault is None:
                fault = f"{node.name}: {tick.outputs.fault}"
        for host in hosts:
            observer.host(host.name, host.tick(t))
        observer.done(t)
        if not armed:
            return Ending(t, fault)
        stop = stopped()  # after that or a fault, one more tick, disarmed, to shut every valve
    clock.wait_until(ticks * period)
    return Ending(ticks * period, fault)
