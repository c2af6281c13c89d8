"""One vehicle's process: cameras and setpoints in, valve commands out.

It asks the host what is flown, gets ready, says so, and waits for the order to start. Whatever
happens then, it ends with closed valves:

* the host is gone, or the network: setpoints run out, the vehicle brakes and its gate closes; with
  the law on board, the permit lapses and the valves are closed;
* this process hangs or is killed: the plan runs out and the board's watchdog latches SAFE;
* the board, its line or the cameras fail: the flight ends, and the host is told.
"""

import math
import threading
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from queue import Empty, SimpleQueue

import msgspec
import numpy as np
import zenoh

from firmware_interface.limits import limits_of
from firmware_interface.serial_thrusters import SerialThrusters
from testbed.config import Experiment
from testbed.core.types import HostTick, Tick
from testbed.flight.loop import VehicleNode, fly
from testbed.ops.children import orphaned
from testbed.ops.mocap.poses import MocapPoses
from testbed.ops.mocap.source import make_source
from testbed.ops.mocap.watch import BodyWatch
from testbed.ops.network.envelope import Inbox, Outbox
from testbed.ops.network.keys import Keys
from testbed.ops.network.links import Party, ZenohVehicleLink
from testbed.ops.network.orders import (
    Accepted,
    Answer,
    Counts,
    Ended,
    Flown,
    Order,
    Pace,
    Permit,
    Refused,
    Start,
    Stop,
)
from testbed.ops.network.session import Ear, Mouth, NetworkError, answer_to, ask, dial, on_word
from testbed.ops.offset import Offset
from testbed.ops.port_gate import PortGate
from testbed.ops.steady import preferred, steady
from testbed.ops.ticking import WallClock, monotonic_ns, sleep_until_ns
from testbed.rig import make_agent, warm_up

PRIORITY = 20
READINGS = 16  # of the host's clock before a flight
LOOK_NS = 10_000_000  # between two looks at what happens, while waiting
SOONEST_NS = 1_000_000_000  # an order to start may be late by so much
FARTHEST_NS = 30_000_000_000  # and early
PATIENCE_S = 60.0  # for a host that does not answer
KEPT_S = 10.0


class VehicleError(Exception):
    """This vehicle cannot fly."""


def read_clock(session: zenoh.Session, keys: Keys) -> Offset:
    """The host's clock, from some questions and answers."""
    clock = Offset()
    for _ in range(READINGS):
        asked = monotonic_ns()
        said = ask(session, keys.clock)
        if len(said) != 8:
            raise NetworkError(f"the host's clock says {len(said)} bytes, expected 8")
        clock.exchanged(asked, int.from_bytes(said, "little"), monotonic_ns())
    return clock


class Tower:
    """The vehicle's ear for what it is told to do."""

    def __init__(
        self, session: zenoh.Session, keys: Keys, name: str, board: str,
        to_own: Callable[[int], int | None] = lambda host_ns: None,
    ) -> None:  # fmt: skip
        """Listen; `to_own` says when a time of the host's clock is on this machine's."""
        self._to_own = to_own
        self.bad_orders = 0  # that were none
        self.starts: SimpleQueue[Start] = SimpleQueue()
        self.stop_reason: str | None = None
        self._board, self._flying = board, threading.Event()
        self._close: Callable[[], None] | None = None
        self._kept = [
            answer_to(session, keys.of(name, "order"), self._order),
            answer_to(session, keys.stop, lambda _: self._stop("stopped by the operator")),
            on_word(session, keys.stop, lambda: self._stop("stopped by the operator")),
        ]

    def take_off(self, close: Callable[[], None]) -> None:
        """From now on a stop calls `close` at once."""
        self._close = close

    def _order(self, data: bytes) -> bytes:
        try:
            order: Order = msgspec.msgpack.decode(data, type=Order)
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
            self.bad_orders += 1
            raise
        answer: Answer
        match order:
            case Stop(reason):
                self._stop(reason)
                answer = Accepted(self._board)
            case Start():
                begin = self._to_own(order.epoch_ns)
                ahead = 0 if begin is None else begin - monotonic_ns()
                if self._flying.is_set():
                    answer = Refused("it flies already")
                elif not -SOONEST_NS <= ahead <= FARTHEST_NS:
                    self.bad_orders += 1
                    answer = Refused(f"to start in {1e-9 * ahead:.1f} s; expected 0 to 30 s")
                else:
                    self._flying.set()
                    self.starts.put(order)
                    answer = Accepted(self._board)
        return msgspec.msgpack.encode(answer)

    def _stop(self, reason: str) -> bytes:
        if self.stop_reason is None:
            self.stop_reason = reason
        if self._close is not None:
            self._close()
        return b"stopped"


class Flight:
    """Observer of the flight, and the one who says that it is over."""

    def __init__(
        self,
        party: Party,
        thrusters: SerialThrusters,
        poses: MocapPoses,
        tower: Tower,
        *,
        on_board: bool,
    ) -> None:
        self._thrusters, self._poses, self._tower = thrusters, poses, tower
        self._clock, self._on_board = party.clock, on_board
        self._mouth = Mouth(party.session, party.keys.of(party.name, "tick"), bulk=True)
        self._out = Outbox(party.run)
        self._permit_ear = Ear(party.session, party.keys.permit)
        self._permit: Inbox[Permit] = Inbox(
            msgspec.msgpack.Decoder(Permit).decode, party.run, party.lab.late_s
        )
        self._k = 0
        self._arrived_ns: dict[int, int] = {}  # the newest pose, by the plan it went into
        self.fault: str | None = None

    def vehicle(self, name: str, tick: Tick) -> None:
        """See `Observer`."""
        if self._poses.arrived_ns is not None:
            self._arrived_ns[tick.outputs.command.seq] = self._poses.arrived_ns
        clock, delay = self._clock, self._pose_to_valve()
        late = clock.lateness[-1] if clock.lateness else 0.0
        flown = Flown(self._k, tick, Pace(late, delay))
        self._k += 1
        self._mouth.say(self._out.seal(flown, clock.now, clock.now + KEPT_S))

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

    def over(self) -> bool:
        """Whether the flight has to end; the valves are closed at once then."""
        for at, data in self._permit_ear.heard():
            self._permit.take(data, self._clock.of(at))
        if self._thrusters.trouble is not None:
            self.fault = self._thrusters.trouble
        elif self._tower.stop_reason is None:
            lapsed = self._clock.now - max(self._permit.valid_until, 0.0)
            if not self._on_board or lapsed <= 0.0 or self._permit.newest is None:
                return False
            self.fault = f"the host's permit lapsed {lapsed:.2f} s ago"
        self._thrusters.disarm()
        return True


def fly_vehicle(
    name: str, endpoint: str, lab: str, port: str | None, badge: Path | None = None, *, child: bool
) -> None:
    """Get ready, wait for the order, fly once, and tell the host how it went.

    Args:
        name: of the vehicle.
        endpoint: of the host.
        lab: first part of the keys.
        port: of the board; None: the table file's.
        badge: its key folder; None: the host is on this machine.
        child: end when standard input does.

    Raises:
        VehicleError: it cannot.
    """

    def gone() -> bool:
        return child and orphaned()

    keys = Keys(lab)
    with ExitStack() as stack:
        session = stack.enter_context(dial(endpoint, PATIENCE_S, badge))
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
        agent = make_agent(experiment, name)
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
        tower = Tower(session, keys, name, thrusters.board, clock_of_host.to_own)
        stack.enter_context(steady())  # now: the last collection of garbage takes its time
        token = session.liveliness().declare_token(keys.of(name, "alive"))
        stack.callback(token.undeclare)
        start = await_start(tower, source.poll, gone)
        if start is None:
            return
        epoch = clock_of_host.to_own(start.epoch_ns)
        assert epoch is not None
        clock = WallClock(epoch)
        thrusters.epoch_us = epoch // 1000
        party = Party(session, wires, start.session, clock, experiment.seed, name)
        on_board = experiment.deploy.law == "vehicle"
        link = ZenohVehicleLink(party, experiment.vehicles)
        poses = MocapPoses(source, wires.mocap, clock, name, BodyWatch())
        event = Mouth(session, keys.of(name, "event"))
        flight = Flight(party, thrusters, poses, tower, on_board=on_board)
        stack.enter_context(preferred(PRIORITY))
        thrusters.bearing(on=True)
        sleep_until_ns(epoch - LOOK_NS)
        thrusters.arm()
        tower.take_off(thrusters.disarm)
        port_gate = PortGate(thrusters, lambda: clock.now, experiment.flight.jet_period_s)
        node = VehicleNode(name, agent, poses, port_gate, link)
        ending = fly(
            clock, [node], [], experiment.flight.jet_period_s, experiment.ticks, flight,
            stopped=flight.over,
        )  # fmt: skip
        thrusters.disarm()
        fault = ending.fault or (f"{name}: {flight.fault}" if flight.fault else None)
        if poses.trouble is not None and fault is not None:
            fault += f"; its body is {poses.trouble}"
        counts = count(link, thrusters, poses, clock_of_host, port_gate.refused)
        out = Outbox(start.session)
        ended = Ended(ending.t, fault, counts)
        event.say(out.seal(ended, clock.now, clock.now + KEPT_S))
        await_end(gone, tower)


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


def await_start(tower: Tower, poll: Callable[[], object], gone: Callable[[], bool]) -> Start | None:
    """The order to fly; None if it will not come."""
    while True:
        try:
            return tower.starts.get_nowait()
        except Empty:
            poll()
            if tower.stop_reason is not None or gone():
                return None
            sleep_until_ns(monotonic_ns() + LOOK_NS)


def await_end(gone: Callable[[], bool], tower: Tower) -> None:
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
