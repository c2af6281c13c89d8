"""The loop that flies an experiment, the same on every rig.

Tick k is due at k * period on the given clock. In each tick every vehicle takes its step first,
with the data that has arrived; then the host computes setpoints for the next one.
"""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Protocol

from msgspec import Struct
from msgspec.structs import replace

from testbed.core.codes import FaultId, FaultReport, Response
from testbed.core.jets import JetHealth
from testbed.core.ports import Clock, HostLink, PoseSource, Thrusters, VehicleLink
from testbed.core.rows import PoseSamples, is_finite, row_of_setpoint
from testbed.core.types import (
    ALL_WELL,
    HostInputs,
    HostOutputs,
    HostTick,
    Inputs,
    Outputs,
    Setpoint,
    State,
    Stick,
    Tick,
    Trajectory,
    Vitals,
)
from testbed.core.warned import Warned
from testbed.flight.faults import LONGEST_WORDS
from testbed.flight.flown_tick import AnyHostTick, AnyTick
from testbed.flight.guidance import Guidance
from testbed.flight.pilot import Pilot
from testbed.flight.witnesses import Witnesses

LONGEST_STOP = 15.0  # after a fault the flight ends at the latest after this time [s]
ENOUGH = 0.9  # of the set pressure: below it a hold ends, while there is gas to brake


def _well() -> Vitals:
    return ALL_WELL


class Chain(Protocol):
    """A vehicle's flight chain: an `Agent`, or several one after the other."""

    @property
    def guidance(self) -> Guidance | None:
        """The guidance, if the law runs on board."""
        ...

    def step(self, inputs: Inputs) -> Outputs:
        """See `Agent`."""
        ...

    @property
    def jets(self) -> tuple[JetHealth, ...]:
        """See `Agent`."""
        ...

    @property
    def warned(self) -> dict[str, Warned]:
        """See `Agent`."""
        ...

    def staying(self, t: float) -> Trajectory | None:
        """See `Agent`."""
        ...


class VehicleNode:
    """An agent and its ports."""

    def __init__(
        self,
        name: str,
        agent: Chain,
        poses: PoseSource,
        thrusters: Thrusters,
        link: VehicleLink,
        vitals: Callable[[], Vitals] = _well,
    ) -> None:
        self.name, self._vitals = name, vitals
        self._agent, self._poses, self._thrusters, self._link = agent, poses, thrusters, link

    @property
    def guidance(self) -> Guidance | None:
        """The guidance, if the law runs on board."""
        return self._agent.guidance

    @property
    def jets(self) -> tuple[JetHealth, ...]:
        """Each jet as the flight has shown it."""
        return self._agent.jets

    @property
    def warned(self) -> dict[str, Warned]:
        """See `Agent`."""
        return self._agent.warned

    def _setpoint(self, t: float, stay: bool) -> Setpoint | None:
        """The place to stay at, or what the host sends; a law on board obeys no other setpoint."""
        if stay:
            return self._agent.staying(t)
        return None if self.guidance is not None else self._link.setpoint()

    def tick(
        self, t: float, armed: bool, fleet: FaultReport | None = None, *,
        end: bool = False, stay: bool = False,
    ) -> Tick:  # fmt: skip
        """Receive, step, act, send.

        Args:
            t: now [s].
            armed: whether valves may open.
            fleet: a fault of another vehicle that stops all.
            end: the flight is over.
            stay: come to rest and hold position, whatever the law says.
        """
        link, vitals = self._link, self._vitals()
        if fleet or end:
            vitals = replace(vitals, fleet=fleet, end=end)
        inputs = Inputs(
            t,
            armed,
            PoseSamples.of(self._poses.samples()),
            self._setpoint(t, stay),
            link.neighbours(),
            self._thrusters.health(),
            link.messages(),
            vitals,
        )
        outputs = self._agent.step(inputs)
        self._thrusters.apply(outputs.command)
        if outputs.air_off or outputs.response == Response.LAND:
            self._thrusters.land()
        if outputs.state is not None:
            link.publish(outputs.state)
        if outputs.message is not None:
            link.broadcast(outputs.message)
        return Tick(inputs, outputs)


class Node(Protocol):
    """A vehicle as the loop sees it."""

    name: str

    def tick(
        self, t: float, armed: bool, fleet: FaultReport | None = None, *,
        end: bool = False, stay: bool = False,
    ) -> AnyTick:  # fmt: skip
        """See `VehicleNode`."""
        ...


class HostNode:
    """One vehicle's law on the host.

    A setpoint sent at a tick reaches the vehicle before its next tick, so it is meant for the jet
    period after the coming one.
    """

    def __init__(
        self, name: str, guidance: Guidance, link: HostLink, period: float, lead: float,
        pilot: Pilot | None = None,
    ) -> None:  # fmt: skip
        self.name, self.guidance, self._link = name, guidance, link
        self.pilot = pilot  # flies by hand instead of the law
        self.stick: Stick | None = None  # of the operator, from this tick on; None: the law flies
        self._ahead = period + lead
        self._fault: FaultReport | None = None  # of the law

    def tick(self, t: float, armed: bool = True) -> AnyHostTick:
        """Receive, step, send. The law starts when the vehicle is armed."""
        link, guidance = self._link, self.guidance
        inputs = HostInputs(t, link.own(), link.neighbours(), link.messages(), self.stick)
        if inputs.own is None or not armed or self._fault is not None:
            return HostTick(inputs, HostOutputs(t, None, fault=self._fault))
        try:
            if inputs.stick is not None and self.pilot is not None:
                return self._by_hand(self.pilot, inputs, inputs.own, inputs.stick)
            if self.pilot is not None and self.pilot.flies:
                self.pilot.flies = False
                guidance.begin(t + self._ahead, inputs.own)
            setpoint = guidance.step(
                t + self._ahead, inputs.own, inputs.neighbours, inputs.messages
            )
        except Exception as error:  # after any exception of a law the vehicles are stopped
            self.fail(error)
            return HostTick(inputs, HostOutputs(t, None, fault=self._fault))
        if not is_finite(row_of_setpoint(setpoint)):
            self.fail(None)
            return HostTick(inputs, HostOutputs(t, None, fault=self._fault))
        link.publish(setpoint)
        if guidance.message is not None:
            link.broadcast(guidance.message)
        return HostTick(inputs, HostOutputs(t, setpoint, guidance.message, None, guidance.filtered))

    def _by_hand(self, pilot: Pilot, inputs: HostInputs, own: State, stick: Stick) -> HostTick:
        setpoint = pilot.step(inputs.t + self._ahead, own, stick, inputs.neighbours)
        self._link.publish(setpoint)
        return HostTick(inputs, HostOutputs(inputs.t, setpoint, filtered=pilot.filtered))

    def fail(self, error: Exception | None) -> None:
        """Ask the law no more: it raised an error, or gave something that is not a number."""
        what, text = FaultId.HOST_LAW_NOT_A_NUMBER, "asks for something that is not a number"
        if error is not None:
            what, text = FaultId.HOST_LAW_RAISED, f"{type(error).__name__}: {error}"[:LONGEST_WORDS]
        self._fault = FaultReport(what, f"law on the host: {text}", self.name)


def host_fault(name: str, tick: AnyHostTick, silent_s: float) -> FaultReport | None:
    """Fault that the host finds: the vehicle's law failed, or the vehicle is silent.

    `silent_s` is the longest time without a state of a vehicle that still flies [s].
    """
    own_t, t = tick.own_t, tick.t
    if tick.fault is None and own_t is not None and not t - own_t <= silent_s:
        text = f"vehicle silent: nothing heard for {t - own_t:.2f} s"
        return FaultReport(FaultId.VEHICLE_SILENT, text, name)
    return tick.fault


class Observer(Protocol):
    """Receives every tick: recorder, progress bar, dashboard. Must not slow the loop down.

    On the twin it may also receive many ticks at once, see `rig.observers.NullObserver.ticks`.
    """

    def vehicle(self, name: str, tick: AnyTick) -> None:
        """Receive one vehicle's inputs and outputs."""
        ...

    def host(self, name: str, tick: AnyHostTick) -> None:
        """One vehicle's law on the host."""
        ...

    def done(self, t: float) -> None:
        """All vehicles and the host have finished the tick at `t`."""
        ...


class Ending(Struct, frozen=True):
    """Time and fault at the end of a flight."""

    t: float  # [s]
    fault: FaultReport | None  # None: flown to the end
    found_t: float | None = None  # when the fault was found, if it was in a tick [s]


def fly(
    clock: Clock,
    vehicles: Sequence[Node],
    hosts: Sequence[HostNode],
    period: float,
    ticks: int,
    observer: Observer,
    *,
    silent_s: float = math.inf,
    stopped: Callable[[], int] = lambda: 0,
    ahead: Callable[[int], int] = lambda k: 0,
) -> Ending:
    """Fly `ticks` jet periods, or until a fault or `stopped()` ends it; `come_to_rest` is next.

    A fault of one vehicle stops all: they come to rest before the flight ends, as in the fault
    table. `stopped()` is the operator's number of stops, looked at when a tick is due. One ends the
    flight before this tick, but lets a stop after a fault continue; the second one ends that, too.
    `silent_s` is that of `host_fault`, for flights with laws on the host.
    `ahead(k)` flies ticks from number `k` on in its own way, shows them to the observer and returns
    how many; it is asked while nothing is wrong.
    """
    fault: FaultReport | None = None
    failed_at, over = 0.0, False
    witnesses = Witnesses()
    k = 0
    while k < ticks:
        if fault is None and (flown := ahead(k)):
            k += flown
            continue
        t = k * period
        clock.wait_until(t)
        asked = stopped() if k else 0  # the first tick is always flown
        if asked and fault is None:
            return Ending(t, None)
        armed, shut, fleet = not (over or asked > 1), True, fault
        for node in vehicles:
            tick = node.tick(t, armed, fleet)
            observer.vehicle(node.name, tick)
            witnesses.add(node.name, tick)
            shut = shut and tick.shut
            if tick.fault is not None and fault is None:
                fault, failed_at = replace(tick.fault, vehicle=node.name), t
        if fault is not None and fleet is None:
            fault = witnesses.blamed(fault)
        for host in hosts:
            answer = host.tick(t, armed)
            observer.host(host.name, answer)
            if fault is None and (trouble := host_fault(host.name, answer, silent_s)):
                fault, failed_at = trouble, t
        observer.done(t)
        if not armed:
            return Ending(t, fault, None if fault is None else failed_at)
        # then one more tick, disarmed, to shut every valve
        over = fault is not None and (shut or t - failed_at >= LONGEST_STOP)
        k += 1
    clock.wait_until(ticks * period)
    return Ending(ticks * period, fault, None if fault is None else failed_at)


def hold(
    clock: Clock,
    vehicles: Sequence[Node],
    period: float,
    first: int,
    ticks: int,
    observer: Observer,
    set_pressure: Mapping[str, float],
    *,
    stopped: Callable[[], int] = lambda: 0,
) -> tuple[int, FaultReport | None]:
    """After the flight: every vehicle comes to rest and stays there.

    A stop, a fault of any vehicle, low supply pressure and the time end it; `come_to_rest` is next.

    Returns:
        number of the next tick, and the fault that ended it.
    """
    for k in range(first, first + ticks):
        clock.wait_until(k * period)
        if stopped():
            return k, None
        enough = True
        for node in vehicles:
            tick, full = node.tick(k * period, True, stay=True), set_pressure[node.name]
            observer.vehicle(node.name, tick)
            if tick.fault is not None:
                return k + 1, replace(tick.fault, vehicle=node.name)
            enough = enough and tick.inputs.health.supply_pressure >= ENOUGH * full
        if not enough:
            return k + 1, None
    return first + ticks, None


def come_to_rest(
    clock: Clock,
    vehicles: Sequence[Node],
    period: float,
    first: int,
    ticks: int,
    observer: Observer,
    *,
    stopped: Callable[[], int] = lambda: 0,
    brakes: Collection[str] = (),
) -> None:
    """After the flight: every vehicle brakes, and at rest its bearing air is turned off.

    Args:
        clock: of the flight.
        vehicles: that flew.
        period: [s].
        first: number of the first tick, counted from the flight's beginning.
        ticks: at most; a vehicle that still moves then lands anyway.
        observer: receives these ticks, too: their vitals have `end`.
        stopped: the operator's number of stops: two shut valves and air at once.
        brakes: vehicles that go on braking then, because that stops them in less distance.
    """
    for k in range(first, first + ticks + 1):
        clock.wait_until(k * period)
        in_time, at_once, down = k < first + ticks, stopped() > 1, True
        for node in vehicles:
            may_brake = in_time and (not at_once or node.name in brakes)
            tick = node.tick(k * period, may_brake, end=True)
            observer.vehicle(node.name, tick)
            down = down and (tick.outputs.air_off or not may_brake)
        if down:
            return
