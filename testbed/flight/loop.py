"""The loop that flies an experiment, the same on every rig.

Tick k is due at k * period of the clock it is handed. In each tick every vehicle takes its step
first, on what has arrived so far; then the host answers for the next one.
"""

import math
from collections.abc import Callable, Sequence
from typing import Protocol

from msgspec import Struct
from msgspec.structs import replace

from testbed.core.ports import Clock, HostLink, PoseSource, Thrusters, VehicleLink
from testbed.core.types import (
    ALL_WELL,
    Demand,
    HostInputs,
    HostOutputs,
    HostTick,
    Inputs,
    Setpoint,
    Tick,
    Vitals,
)
from testbed.flight.agent import Agent
from testbed.flight.guidance import Guidance

SILENT = 1.2  # [s] a host that has not heard of its vehicle for so long stops all
LONGEST_WORDS = 300  # characters of what a law dies of: it goes over the network
LONGEST_STOP = 15.0  # [s] the flight ends so long after a fault, whoever still moves


def _well() -> Vitals:
    return ALL_WELL


class VehicleNode:
    """An agent and the ports it is plugged into."""

    def __init__(
        self,
        name: str,
        agent: Agent,
        poses: PoseSource,
        thrusters: Thrusters,
        link: VehicleLink,
        vitals: Callable[[], Vitals] = _well,
    ) -> None:
        self.name, self._vitals = name, vitals
        self._agent, self._poses, self._thrusters, self._link = agent, poses, thrusters, link

    @property
    def guidance(self) -> Guidance | None:
        """The law at work, if it runs on board."""
        return self._agent.guidance

    def tick(self, t: float, armed: bool, fleet: str = "", end: str = "") -> Tick:
        """Listen, step, act, tell.

        Args:
            t: now [s].
            armed: whether valves may open.
            fleet: a fault elsewhere that stops all.
            end: why the flight is over; empty: it is not.
        """
        link, vitals = self._link, self._vitals()
        if fleet or end:
            vitals = replace(vitals, fleet=fleet, end=end)
        inputs = Inputs(
            t,
            armed,
            tuple(self._poses.samples()),
            link.setpoint(),
            link.neighbours() if self._agent.hears_neighbours else {},
            self._thrusters.health(),
            link.messages() if self._agent.hears_neighbours else {},
            vitals,
        )
        outputs = self._agent.step(inputs)
        self._thrusters.apply(outputs.command)
        if outputs.air_off or outputs.response == "land":
            self._thrusters.land()
        if outputs.state is not None:
            link.publish(outputs.state)
        if outputs.message is not None:
            link.broadcast(outputs.message)
        return Tick(inputs, outputs)


def _is_number(setpoint: Setpoint) -> bool:
    """Whether a setpoint is fit to be sent; of a trajectory the newest reference."""
    if isinstance(setpoint, Demand):
        return math.isfinite(setpoint.fx_w + setpoint.fy_w)
    pose = setpoint.references[-1].pose
    return math.isfinite(pose.x + pose.y)


class Node(Protocol):
    """A vehicle as the loop sees it."""

    name: str

    def tick(self, t: float, armed: bool, fleet: str = "", end: str = "") -> Tick:
        """See `VehicleNode`."""
        ...


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
        self._law_error = ""  # what the law died of

    def tick(self, t: float, armed: bool = True) -> HostTick:
        """Listen, step, tell. The law starts when the vehicle is armed, not before."""
        link, guidance = self._link, self.guidance
        inputs = HostInputs(t, link.own(), link.neighbours(), link.messages())
        if inputs.own is None or not armed or self._law_error:
            return HostTick(inputs, HostOutputs(t, None, law_error=self._law_error))
        try:
            setpoint = guidance.step(
                t + self._ahead, inputs.own, inputs.neighbours, inputs.messages
            )
        except Exception as error:  # whatever a law dies of, the vehicles are brought to a stop
            self._law_error = f"{type(error).__name__}: {error}"[:LONGEST_WORDS]
            return HostTick(inputs, HostOutputs(t, None, law_error=self._law_error))
        if not _is_number(setpoint):
            self._law_error = "asks for something that is not a number"
            return HostTick(inputs, HostOutputs(t, None, law_error=self._law_error))
        link.publish(setpoint)
        if guidance.message is not None:
            link.broadcast(guidance.message)
        return HostTick(inputs, HostOutputs(t, setpoint, guidance.message, "", guidance.filtered))


def complaint(tick: HostTick) -> str:
    """What a host has to complain of: its law, or a vehicle that is silent."""
    if tick.outputs.law_error:
        return f"law on the host: {tick.outputs.law_error}"
    own, t = tick.inputs.own, tick.inputs.t
    if own is not None and not t - own.t <= SILENT:
        return f"vehicle_silent: nothing heard for {t - own.t:.2f} s"
    return ""


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
    vehicles: Sequence[Node],
    hosts: Sequence[HostNode],
    period: float,
    ticks: int,
    observer: Observer,
    *,
    stopped: Callable[[], int] = lambda: 0,
) -> Ending:
    """Fly `ticks` jet periods, or until a fault or `stopped()` ends it; `come_to_rest` is next.

    A fault of one stops all: all come to rest before the flight ends, as the fault table says.
    `stopped()` is how often an operator has said stop. Once ends the flight with this tick, but not
    a stop for a fault, which is under way; twice ends that, too.
    """
    fault, failed_at, stop = None, 0.0, False
    for k in range(ticks):
        t = k * period
        clock.wait_until(t)
        armed, shut, fleet = not stop, True, fault or ""
        for node in vehicles:
            tick = node.tick(t, armed, fleet)
            observer.vehicle(node.name, tick)
            shut = shut and tick.outputs.inhibit_reason is not None
            if tick.outputs.fault and fault is None:
                fault, failed_at = f"{node.name}: {tick.outputs.fault}", t
        for host in hosts:
            answer = host.tick(t, armed)
            observer.host(host.name, answer)
            if fault is None and (trouble := complaint(answer)):
                fault, failed_at = f"{host.name}: {trouble}", t
        observer.done(t)
        if not armed:
            return Ending(t, fault)
        asked = stopped()
        if asked and fault is None:
            clock.wait_until((k + 1) * period)
            return Ending((k + 1) * period, None)
        over = fault is not None and (shut or t - failed_at >= LONGEST_STOP)
        stop = asked > 1 or over  # then one more tick, disarmed, to shut every valve
    clock.wait_until(ticks * period)
    return Ending(ticks * period, fault)


def come_to_rest(
    clock: Clock,
    vehicles: Sequence[Node],
    period: float,
    first: int,
    ticks: int,
    observer: Observer,
    why: str,
    *,
    stopped: Callable[[], int] = lambda: 0,
) -> None:
    """After the flight: every vehicle brakes, and at rest its bearing air is shut off.

    Args:
        clock: of the flight.
        vehicles: that flew.
        period: [s].
        first: number of the first tick, counted from the flight's beginning.
        ticks: at most; whoever is not at rest by then lands as it is.
        observer: is shown these ticks, too: their vitals have `end`.
        why: the flight is over, in words.
        stopped: how often an operator has said stop: twice shuts valves and air at once.
    """
    for k in range(first, first + ticks + 1):
        clock.wait_until(k * period)
        may_brake, down = k < first + ticks and stopped() <= 1, True
        for node in vehicles:
            tick = node.tick(k * period, may_brake, "", why)
            observer.vehicle(node.name, tick)
            down = down and tick.outputs.air_off
        if down or not may_brake:
            return
