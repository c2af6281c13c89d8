"""One vehicle's process: cameras and setpoints in, valve commands out.

It asks the host what is flown, gets ready, says so, and waits for the order to start. Whatever
happens then, it ends with closed valves:

* the host is gone, or the network: setpoints run out and the permit, and the vehicle does what the
  fault table says, wherever its law runs;
* this process hangs or is killed: the plan runs out and the board's watchdog latches SAFE;
* the board, its line or the cameras fail: the flight ends, and the host is told.
"""

import math
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from queue import Empty

import msgspec
import numpy as np
import zenoh

from firmware_interface.limits import limits_of
from firmware_interface.serial_thrusters import SerialThrusters
from testbed.config import Experiment
from testbed.core.types import HostTick, Tick, Vitals
from testbed.files import write_atomic
from testbed.flight.loop import VehicleNode, fly
from testbed.mocap.body_monitor import BodyWatch
from testbed.mocap.poses import MocapPoses
from testbed.mocap.source import make_source
from testbed.net.clock import HostClock, Reader, read_clock
from testbed.net.commands import (
    Counts,
    Ended,
    Flown,
    Lease,
    Pace,
    Start,
    config_id,
)
from testbed.net.envelope import Inbox, Outbox, Verdict
from testbed.net.impairment import NetworkImpairment
from testbed.net.keys import Keys
from testbed.net.links import Party, ZenohVehicleLink
from testbed.net.session import NetworkError, NobodyError, Publisher, Subscriber, ask, dial
from testbed.realtime.clock_sync import Offset
from testbed.realtime.law_watch import patience
from testbed.realtime.processes import orphaned
from testbed.realtime.scheduling import preferred, steady
from testbed.realtime.wall_clock import WallClock, monotonic_ns, sleep_until_ns
from testbed.rig.chain import make_agent, watched
from testbed.rig.twin import warm_up
from testbed.rig.wired.command_guard import CommandGuard
from testbed.rig.wired.command_server import CommandServer
from testbed.rig.wired.preflight_monitor import PreflightMonitor
from testbed.rig.wired.process_faults import Rehearsal

PRIORITY = 20
LOOK_NS = 10_000_000  # between two looks at what happens, while waiting
PATIENCE_S = 60.0  # for a host that does not answer
TRY_S = 2.0
ALONE_NS = 2_000_000_000  # some leases of a network that was cut
KEPT_S = 10.0
PERMITTED_S = 3.0  # a flight that the host has not permitted by then will not be


class VehicleError(Exception):
    """This vehicle cannot fly."""


def unheard(_: str) -> None:
    """Nobody is at a terminal."""


class Flight:
    """Observer of the flight, and the one who says that it is over."""

    def __init__(
        self,
        party: Party,
        thrusters: SerialThrusters,
        poses: MocapPoses,
        tower: CommandServer,
        config: str,
        drift: HostClock,
        link: ZenohVehicleLink,
        rehearsal: Rehearsal,
    ) -> None:
        self._link, self._foreign = link, 0
        self.rehearsal, self.due = rehearsal, 0.0
        self._storm = NetworkImpairment(
            party.lab.weather, party.seed, f"permit to {party.name}", party.worse
        )

        self._thrusters, self._poses, self._tower = thrusters, poses, tower
        self._clock, self._config, self._offset = party.clock, config, drift.off
        self._drift = drift
        self._mouth = Publisher(party.session, party.keys.of(party.name, "tick"), bulk=True)
        self._out = Outbox(party.run)
        self._permit_ear = Subscriber(party.session, party.keys.permit, self._storm.arrival)
        self._permit: Inbox[Lease] = Inbox(
            msgspec.msgpack.Decoder(Lease).decode, party.run, party.lab.late_s
        )
        self._k = 0
        self.rows: dict[str, float] = {}  # of the fault table that held, and since when [s]
        self.responses: dict[str, float] = {}  # and what was done about them
        self._arrived_ns: dict[int, int] = {}  # the newest pose, by the plan it went into
        self.fault: str | None = None

    def vehicle(self, name: str, tick: Tick) -> None:
        """See `Observer`."""
        self._poses.review()
        out = tick.outputs
        for row in out.faults:
            self.rows.setdefault(row, out.t)
        if out.response:
            self.responses.setdefault(out.response, out.t)
        if self._poses.arrived_ns is not None:
            self._arrived_ns[tick.outputs.command.seq] = self._poses.arrived_ns
        clock = self._clock
        edges = tuple(self._thrusters.edges())
        flown = Flown(self._k, tick, self._pace(tick.inputs.vitals.late_s), edges)
        self._k += 1
        self._mouth.say(self._out.seal(flown, clock.now, clock.now + KEPT_S))

    def _pace(self, late: float) -> Pace:
        inbox, poses = self._link.heard.inbox, self._poses
        heard = inbox.counts[Verdict.TAKEN]
        return Pace(
            late, self._pose_to_valve(), inbox.delay, heard, inbox.missed,
            sum(inbox.counts.values()) - heard, self._drift.trip,
            str(poses.trouble or ""), poses.lost_frames,
        )  # fmt: skip

    def _pose_to_valve(self) -> float | None:
        """Of the newest plan that is known to have gone out [s]."""
        delay = None
        while self._thrusters.sent:
            seq, at_us = self._thrusters.sent.popleft()
            arrived = self._arrived_ns.pop(seq, None)
            delay = None if arrived is None else 1e-6 * at_us - 1e-9 * arrived
        return delay

    def host(self, name: str, tick: HostTick) -> None:
        """See `Observer`."""

    def done(self, t: float) -> None:
        """See `Observer`."""

    def vitals(self) -> Vitals:
        """What this process knows of itself, the network and the operator."""
        for at, data in self._permit_ear.heard():
            self._permit.take(data, self._clock.of(at))
        clock, permit = self._clock, self._permit.newest
        late = max(0.0, clock.now - self.due)
        before, self._foreign = self._foreign, self._permit.foreign + self._link.foreign
        if permit is None:
            return Vitals(operator_age=max(0.0, clock.now), late_s=late)
        return Vitals(
            operator_age=max(0.0, clock.now - self._permit.issued_at),
            clock_offset=self._offset(),
            late_s=late,
            disk_free=permit.disk_free,
            same_config=permit.config == self._config,
            fleet=permit.fleet,
            foreign=self._foreign - before,
        )

    @property
    def may_fire(self) -> bool:
        """Whether the host's supervisor lets this vehicle fire; not before its first word."""
        return self._permit.newest is not None and self._permit.newest.may_fire

    def over(self) -> bool:
        """Whether the flight has to end; the valves are closed at once then."""
        permit = self._permit.newest
        if self._thrusters.trouble is not None:
            self.fault = self._thrusters.trouble
        elif permit is None and self._clock.now > PERMITTED_S:
            self.fault = "the host has never permitted the flight"
        elif self._tower.stop_reason is None and (permit is None or permit.may_fire):
            return False
        self._thrusters.disarm()
        return True


class Permitted:
    """A node that is armed only while the host's supervisor says so."""

    def __init__(self, node: VehicleNode, flight: Flight, clock: WallClock) -> None:
        self.name, self._node, self._flight, self._clock = node.name, node, flight, clock

    def tick(self, t: float, armed: bool, fleet: str = "") -> Tick:
        """See `VehicleNode`."""
        self._flight.due = t
        self._flight.rehearsal.at_vehicle(self.name, self._clock)
        return self._node.tick(t, armed and self._flight.may_fire, fleet)


def fly_vehicle(
    name: str, endpoint: str, lab: str, port: str | None, badge: Path | None = None, *,
    child: bool, report: Path | None = None, say: Callable[[str], None] = unheard,
) -> None:  # fmt: skip
    """Get ready, wait for the order, fly once, and tell the host how it went.

    Args:
        name: of the vehicle.
        endpoint: of the host.
        lab: first part of the keys.
        port: of the board; None: the table file's.
        badge: its key folder; None: the host is on this machine.
        child: end when standard input does.
        report: a file for its last words, for when the host is gone.
        say: tells somebody at a terminal how far it is; by default nobody.

    Raises:
        VehicleError: it cannot.
    """

    def gone() -> bool:
        return child and orphaned()

    keys = Keys(lab)
    with ExitStack() as stack:
        session = stack.enter_context(await_host(endpoint, badge, gone))
        experiment = ask_experiment(session, keys, gone)
        if name not in experiment.vehicles:
            raise VehicleError(f"the host flies {', '.join(experiment.vehicles)}, not {name}")
        setup, wires = experiment.vehicles[name], experiment.table.lab
        port = port or wires.serial.ports.get(name)
        if port is None:
            raise VehicleError(
                f"no serial port for {name}: expected --serial, or an entry of"
                " [lab.serial.ports] in the table file"
            )
        say(f"the host flies {experiment.name}; getting ready (compiles on the first run)")
        clock = WallClock(monotonic_ns())  # until the run's time 0 is known
        rehearsal = Rehearsal(experiment.inject, lambda: clock.now)
        spoilt = partial(rehearsal.spoilt, name) if experiment.inject else None
        stack.enter_context(watched(experiment))
        agent = make_agent(experiment, name, spoilt)
        with patience():
            warm_up(experiment)
        if child:
            await_port(port, gone)
        source = make_source(wires.mocap, session, keys)
        stack.callback(source.close)
        thrusters = stack.enter_context(
            SerialThrusters(
                port, limits_of(setup.model), setup.model.command_delay_s,
                monotonic_ns() & 0xFFFFFFFF, wires.serial.baud,
                setup.model.air.set_pressure,
            )
        )  # fmt: skip
        clock_of_host = read_clock(session, keys)
        reader = Reader(session, keys, clock_of_host)
        # nobody has anything to say there before the order to start
        strangers = [Subscriber(session, key) for key in (keys.of(name, "setpoint"), keys.permit)]
        lookout = PreflightMonitor(experiment, name, source, thrusters, reader, strangers)
        tower = CommandServer(session, keys, name, thrusters.board, lookout, clock_of_host.to_own)
        stack.enter_context(steady())  # now: the last collection of garbage takes its time
        await_alone(session, keys, name)
        token = session.liveliness().declare_token(keys.of(name, "alive"))
        stack.callback(token.undeclare)
        say(f"ready, board at {port}; waiting for the host's order to start")
        start = await_start(tower, lookout.look, gone)
        if start is None:
            say(f"not flown: {tower.stop_reason or 'its parent is gone'}")
            return
        say("flies")
        epoch = clock_of_host.to_own(start.epoch_ns)
        assert epoch is not None
        clock.epoch_ns = epoch
        thrusters.epoch_us = epoch // 1000
        worse = partial(rehearsal.air, name)
        party = Party(session, wires, start.session, clock, experiment.seed, name, worse)
        link = ZenohVehicleLink(party, experiment.vehicles)
        event = Publisher(session, keys.of(name, "event"))
        drift = HostClock(session, keys, clock, start.epoch_ns)
        stack.enter_context(preferred(PRIORITY))
        thrusters.bearing(on=True)
        while monotonic_ns() < epoch - LOOK_NS:
            lookout.look()
            sleep_until_ns(min(monotonic_ns() + LOOK_NS, epoch - LOOK_NS))
        for ear in strangers:
            ear.close()
        poses = MocapPoses(source, wires.mocap, clock, name, BodyWatch())
        flight = Flight(
            party, thrusters, poses, tower, config_id(experiment), drift, link, rehearsal
        )
        if tower.stop_reason is None:
            thrusters.arm()
        tower.take_off(thrusters.disarm)
        port_gate = CommandGuard(thrusters, lambda: clock.now, experiment.flight.jet_period_s)
        node = VehicleNode(name, agent, poses, port_gate, link, flight.vitals)
        ending = fly(
            clock, [Permitted(node, flight, clock)], [], experiment.flight.jet_period_s,
            experiment.ticks, flight, stopped=flight.over,
        )  # fmt: skip
        thrusters.disarm()
        fault = ending.fault or (f"{name}: {flight.fault}" if flight.fault else None)
        if poses.trouble is not None and fault is not None:
            fault += f"; its body is {poses.trouble}"
        counts = count(link, thrusters, poses, clock_of_host, port_gate.refused)
        out = Outbox(start.session)
        ended = Ended(ending.t, fault, counts, flight.rows, flight.responses)
        if report is not None:
            write_atomic(report, msgspec.json.encode(ended))
        event.say(out.seal(ended, clock.now, clock.now + KEPT_S))
        say(f"ended after {ending.t:.1f} s{f' by a fault: {fault}' if fault else ''}")
        await_end(gone, tower)


def await_host(endpoint: str, badge: Path | None, gone: Callable[[], bool]) -> zenoh.Session:
    """The host, as soon as it listens; in short tries, because none of them hears Ctrl-C."""
    end = monotonic_ns() + round(1e9 * PATIENCE_S)
    while True:
        try:
            return dial(endpoint, TRY_S, badge)
        except NobodyError:
            if monotonic_ns() > end or gone():
                raise


def await_alone(session: zenoh.Session, keys: Keys, name: str) -> None:
    """See that nobody else flies under this name; one that was killed is forgotten by then.

    Raises:
        VehicleError: somebody does.
    """
    end = monotonic_ns() + ALONE_NS
    while list(session.liveliness().get(keys.of(name, "alive"), timeout=1.0)):
        if monotonic_ns() > end:
            raise VehicleError(
                f"somebody else flies as {name}: expected one `testbed agent` for each vehicle;"
                " end the other, or wait until its flight is over"
            )
        sleep_until_ns(monotonic_ns() + 10 * LOOK_NS)


def ask_experiment(session: zenoh.Session, keys: Keys, gone: Callable[[], bool]) -> Experiment:
    """What the host flies."""
    end = monotonic_ns() + round(1e9 * PATIENCE_S)
    while True:
        try:
            return msgspec.json.decode(ask(session, keys.experiment), type=Experiment)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            raise VehicleError(
                f"the host's experiment cannot be read: {error}; is it of the same version?"
            ) from None
        except NetworkError:
            if monotonic_ns() > end or gone():
                raise
        sleep_until_ns(monotonic_ns() + 20 * LOOK_NS)


def await_port(port: str, gone: Callable[[], bool]) -> None:
    """On the bench the port may appear a little later than this process; then go on anyway."""
    end = monotonic_ns() + round(1e9 * PATIENCE_S)
    while not Path(port).exists() and monotonic_ns() < end and not gone():
        sleep_until_ns(monotonic_ns() + LOOK_NS)


def await_start(
    tower: CommandServer, poll: Callable[[], object], gone: Callable[[], bool]
) -> Start | None:
    """The order to fly; None if it will not come."""
    while True:
        try:
            return tower.starts.get_nowait()
        except Empty:
            poll()
            if tower.stop_reason is not None or gone():
                return None
            sleep_until_ns(monotonic_ns() + LOOK_NS)


def await_end(gone: Callable[[], bool], tower: CommandServer) -> None:
    """Give the last word time to get out."""
    end = monotonic_ns() + 500_000_000
    while monotonic_ns() < end and not gone():
        sleep_until_ns(monotonic_ns() + LOOK_NS)


def count(
    link: ZenohVehicleLink, thrusters: SerialThrusters, poses: MocapPoses, clock: Offset,
    unsent: int,
) -> Counts:  # fmt: skip
    """What became of messages and frames."""
    best = clock.best
    latency = float(np.median(poses.latencies)) if poses.latencies else math.nan
    return Counts(
        commands={str(k): n for k, n in link.heard.inbox.counts.items()},
        refusals=thrusters.refusals | ({"not_sent": unsent} if unsent else {}),
        mocap={str(k): n for k, n in poses.watch.counts.items()},
        lost_frames=poses.lost_frames,
        reconnects=thrusters.reconnects,
        mocap_latency_ms=None if math.isnan(latency) else 1e3 * latency,
        clock_offset_ms=None if best is None else 1e-6 * best.offset_ns,
    )
