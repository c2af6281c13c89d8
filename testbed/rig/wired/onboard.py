"""The flight in a vehicle's process: what ends it, and how the vehicle lands."""

import math
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

import msgspec

from testbed.config import Experiment
from testbed.core.codes import FaultId, FaultReport, Response
from testbed.core.types import Tick, Vitals
from testbed.flight.flown_tick import AnyHostTick, AnyTick
from testbed.flight.frame_watch import FrameWatch
from testbed.flight.loop import Ending, VehicleNode, come_to_rest, hold
from testbed.flight.safety import SPARE_S
from testbed.mocap.poses import MocapPoses
from testbed.net.clock import HostClock
from testbed.net.commands import (
    Lease,
    Pace,
    TickReport,
)
from testbed.net.envelope import Acceptance, Inbox, Outbox
from testbed.net.impairment import NetworkImpairment
from testbed.net.links import Party, ZenohVehicleLink
from testbed.net.session import Publisher, Subscriber
from testbed.realtime.wall_clock import WallClock, monotonic_ns, sleep_until_ns
from testbed.rig.interface import holds
from testbed.rig.wired.command_server import CommandServer
from testbed.rig.wired.flood import FloodWatch
from testbed.rig.wired.process_faults import ProcessFaults
from testbed.rig.wired.stop_requests import StopCount, StopRequests
from testbed.rig.wired.thrusters import WiredThrusters
from testbed.rig.wired.valve_watch import ValveWatch

LOOK_NS = 10_000_000  # polling period while waiting
KEPT_S = 10.0
AIR_S = 1.0  # time for a board to report that its bearing air is off
FIRST_LEASE_S = 3.0  # without a lease by then the flight ends


class VehicleFlight:
    """Observes the flight and decides when it is over."""

    def __init__(
        self,
        party: Party,
        thrusters: WiredThrusters,
        poses: MocapPoses,
        commands: CommandServer,
        config: str,
        host_clock: HostClock,
        link: ZenohVehicleLink,
        process_faults: ProcessFaults,
        brakes: bool,
        frame: FrameWatch,
        watch: ValveWatch,
    ) -> None:
        """With `brakes` the vehicle brakes in an emergency, and else lands."""
        self._watch, self._edges, self._late_s = watch, list[tuple[float, int]](), 0.0
        self._link, self._foreign, self.brakes, self._frame = link, 0, brakes, frame
        self.process_faults, self.due = process_faults, 0.0
        self._impairment = NetworkImpairment(
            party.lab.impairment, party.seed, f"lease to {party.name}", party.worse
        )

        self._thrusters, self._poses, self._commands = thrusters, poses, commands
        self._clock, self._config, self._offset = party.clock, config, host_clock.off
        self._host_clock = host_clock
        self._publisher = Publisher(party.session, party.keys.of(party.name, "tick"), bulk=True)
        self._out = Outbox(party.run)
        self._lease_subscriber = Subscriber(
            party.session, party.keys.lease, self._impairment.arrival
        )
        self._lease: Inbox[Lease] = Inbox(
            msgspec.msgpack.Decoder(Lease).decode, party.run, party.lab.late_s
        )
        self.flood = FloodWatch(self._arrived, lambda: poses.senseless)
        self._k = 0
        self.rows: dict[str, float] = {}  # fault rows that held, and since when [s]
        self.responses: dict[Response, float] = {}  # active responses, and since when [s]
        self._arrived_ns: dict[int, int] = {}  # arrival of the newest pose, by plan number
        self.fault: FaultReport | None = None
        self.signals = StopRequests()  # Ctrl-C at this vehicle's terminal
        self._stops = StopCount(lambda: self.signals.times, commands.stops)
        self.landed_at: float | None = None  # when its air was ordered off [s]

    def vehicle(self, name: str, tick: AnyTick) -> None:
        """See `Observer`."""
        assert isinstance(tick, Tick)  # the only kind on wires
        self._poses.review()
        out = tick.outputs
        if out.air_off and self.landed_at is None:
            self.landed_at = out.t
        if not tick.inputs.vitals.end:
            for row in out.faults:
                self.rows.setdefault(row, out.t)
            self.flood.look(out.t)
            if self.flood.since is not None:
                self.rows.setdefault(FaultId.FLOODED, self.flood.since)
            if out.response:
                self.responses.setdefault(out.response, out.t)
        if self._poses.arrived_ns is not None:
            self._arrived_ns[tick.outputs.command.seq] = self._poses.arrived_ns
        clock = self._clock
        self._watch.plan(out.command)
        self._hear_edges()
        edges, self._edges = tuple(self._edges), []
        flown = TickReport(
            self._k,
            tick,
            self._pace(self._late_s),
            edges,
            self._commands.operator_stops,
            self._commands.stops.marks,
        )
        self._k += 1
        self._publisher.send(self._out.seal(flown, clock.now, clock.now + KEPT_S))

    def _hear_edges(self) -> None:
        new = self._thrusters.edges()
        self._watch.receive(new)
        self._edges += new

    def _arrived(self) -> dict[str, int]:
        return self._link.arrived | {"leases": self._lease_subscriber.arrived}

    def _pace(self, late: float) -> Pace:
        inbox, poses = self._link.setpoints.inbox, self._poses
        taken = inbox.counts[Acceptance.TAKEN]
        return Pace(
            late, self._pose_to_valve(), inbox.delay, taken, inbox.missed,
            sum(inbox.counts.values()) - taken, self._host_clock.trip,
            str(poses.trouble or ""), poses.lost_frames,
        )  # fmt: skip

    def _pose_to_valve(self) -> float | None:
        """Pose-to-valve latency of the newest plan that was sent [s]."""
        delay = None
        while self._thrusters.sent:
            seq, at_us = self._thrusters.sent.popleft()
            arrived = self._arrived_ns.pop(seq, None)
            delay = None if arrived is None else 1e-6 * at_us - 1e-9 * arrived
        return delay

    def host(self, name: str, tick: AnyHostTick) -> None:
        """See `Observer`."""

    def done(self, t: float) -> None:
        """See `Observer`."""

    def vitals(self) -> Vitals:
        """Vital data of this process, the network and the operator."""
        for at, data in self._lease_subscriber.received():
            self._lease.take(data, self._clock.of(at))
        self._frame.look(self._poses.reference_bodies())
        clock, lease = self._clock, self._lease.newest
        self._late_s = max(0.0, clock.now - self.due)
        self._hear_edges()
        late = max(self._late_s, self._watch.late_s(clock.now))
        before, self._foreign = self._foreign, self._lease.foreign + self._link.foreign
        if lease is None:
            return Vitals(operator_age=max(0.0, clock.now), late_s=late)
        return Vitals(
            operator_age=max(0.0, clock.now - self._lease.issued_at),
            clock_offset=self._offset(),
            late_s=late,
            disk_free=lease.disk_free,
            same_config=lease.config == self._config,
            fleet=lease.fleet or self._frame.fault,
            foreign=self._foreign - before,
        )

    @property
    def may_fire(self) -> bool:
        """Whether the host's supervisor lets this vehicle fire; false before its first lease."""
        return self._lease.newest is not None and self._lease.newest.may_fire

    def over(self) -> int:
        """Number of stop requests; 2 shut valves and air at once, or brake if that is shorter."""
        times = self._stops_so_far()
        if times > 1 and (not self.brakes or self._thrusters.trouble is not None):
            self._thrusters.land()
        if times:
            self._commands.obey()
        return times

    def _stops_so_far(self) -> int:
        lease, commands = self._lease.newest, self._commands
        if self._thrusters.trouble is not None:  # the jets cannot be trusted
            if self.fault is None:
                self.responses.setdefault(Response.LAND, self._clock.now)
            self.fault = self.fault or self._thrusters.trouble
            return 2
        if lease is None and self._clock.now > FIRST_LEASE_S:
            self.fault = FaultReport(FaultId.NO_LEASE, "the host never permitted the flight")
            return 2
        if lease is not None and lease.at_once:
            return 2
        if self.signals.times:
            stop = FaultReport(FaultId.STOPPED, "stopped at the vehicle's own terminal")
            self.fault = self.fault or stop
        stopped = commands.stop_reason is not None or (lease is not None and not lease.may_fire)
        return max(self._stops(), int(stopped))


class LeasedNode:
    """A node that is armed only while the host's supervisor permits it."""

    def __init__(self, node: VehicleNode, flight: VehicleFlight, clock: WallClock) -> None:
        self.name, self._node, self._flight, self._clock = node.name, node, flight, clock

    def tick(
        self, t: float, armed: bool, fleet: FaultReport | None = None, *,
        end: bool = False, stay: bool = False,
    ) -> Tick:  # fmt: skip
        """See `VehicleNode`. Coming to rest at the end needs no lease."""
        self._flight.due = t
        self._flight.process_faults.at_vehicle(self.name, self._clock)
        may_fire = self._flight.may_fire or end
        return self._node.tick(t, armed and may_fire, fleet, end=end, stay=stay)


@contextmanager
def counted(stops: StopRequests) -> Iterator[None]:
    """While open, Ctrl-C and SIGTERM are counted as stops, which the loop obeys."""
    if threading.current_thread() is not threading.main_thread():  # it gets no signals
        yield
        return
    numbers = (signal.SIGINT, signal.SIGTERM)

    def count(number: int, frame: FrameType | None) -> None:
        stops.times += 1

    before = {number: signal.signal(number, count) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def land(
    experiment: Experiment, ending: Ending, clock: WallClock, node: LeasedNode,
    flight: VehicleFlight, thrusters: WiredThrusters,
) -> FaultReport | None:  # fmt: skip
    """Hold position if asked to, come to rest and turn the air off, after any end of the flight.

    Returns:
        the fault that ended a hold.
    """
    params, period = experiment.flight.ending, experiment.flight.jet_period_s
    # after a fault the last tick was at the end, otherwise one period before
    first, ended_by = round(ending.t / period) + (ending.fault is not None), None
    if holds(experiment, ending):
        first, ended_by = hold(
            clock, [node], period, first, math.ceil(params.hold_s / period), flight,
            {node.name: experiment.vehicles[node.name].model.air.set_pressure},
            stopped=flight.over,
        )  # fmt: skip
    come_to_rest(
        clock, [node], period, first, math.ceil((params.brake_s + SPARE_S) / period), flight,
        stopped=flight.over, brakes=[node.name] if flight.brakes else (),
    )  # fmt: skip
    thrusters.land()
    flight.landed_at = clock.now if flight.landed_at is None else flight.landed_at
    end = monotonic_ns() + round(1e9 * AIR_S)
    while thrusters.floats and monotonic_ns() < end:
        sleep_until_ns(monotonic_ns() + LOOK_NS)
        thrusters.land()
    return ended_by
