"""The flight in the host's process: laws, leases and the vehicles' reports."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from typing import Protocol

import msgspec
from msgspec.structs import replace

from testbed.config import Experiment
from testbed.config.thresholds import vehicle_silent_s
from testbed.core.codes import FaultId, FaultReport
from testbed.core.law import Concern
from testbed.core.ports import Clock
from testbed.flight.flown_tick import AnyHostTick, AnyTick
from testbed.flight.loop import Ending, Observer, fly
from testbed.flight.supervisor import Supervisor
from testbed.net.commands import Ended, Lease, Stop, TickReport, config_id
from testbed.net.envelope import Acceptance, Inbox, Outbox
from testbed.net.links import LocalMessages, Party, ZenohHostLink, host_states
from testbed.net.session import NetworkError, Publisher, Subscriber
from testbed.realtime.scheduling import realtime_priority
from testbed.realtime.wall_clock import monotonic_ns, sleep_until_ns
from testbed.rig.forked import ForkedHost, make_host
from testbed.rig.interface import holds
from testbed.rig.live import LiveFlight
from testbed.rig.wired.gains import RemoteLaw
from testbed.rig.wired.intruder import Intruder
from testbed.rig.wired.pause import Pause
from testbed.rig.wired.preflight import order
from testbed.rig.wired.process_faults import ProcessFaults
from testbed.rig.wired.remote_node import RemoteNode
from testbed.rig.wired.stop_requests import StopCount, StopRequests
from testbed.rig.wired.truth import newest_truth

PRIORITY = 10  # below the vehicles, which drive the valves
LEASE_S = 1.0  # lifetime of a lease: as long as the operator may be absent
LOST_S, LOST_TICKS = 1.0, 10  # a vehicle that was not heard for both is lost
WAIT_S = 4.0  # time for the vehicles' final reports, beyond their longest brake
LOOK_NS = 20_000_000
LEASE_NS = 100_000_000  # between two leases after the end
WORDS_S = 1.0  # from a vehicle's last tick to its final report


class Book(Protocol):
    """Records the data of a flight."""

    def note_truth(self, poses: dict[str, list[float]]) -> None:
        """Record the newest truth."""
        ...

    def note_tick(self, name: str, flown: TickReport) -> None:
        """Record a vehicle's tick."""
        ...

    def note_end(self, name: str, ended: Ended) -> None:
        """Record a vehicle's final report."""
        ...

    def note_loop(self, late_s: float, busy_s: float) -> None:
        """Record the timing of the host's newest tick."""
        ...

    def note_host(self, lateness: list[float], sent: int) -> None:
        """Record the host's timing over the whole flight."""
        ...


class HostFlight:
    """The flight as the host sees it: leases, reports, stops.

    Args:
        experiment: the experiment to fly.
        book: records the data of the flight.
        party: this end of the network.
        disk_free: free space on the disk of the log [bytes].
        stops: counts stops from any terminal.
        live: carries out the operator's requests; None: the flight cannot be changed.
    """

    def __init__(
        self,
        experiment: Experiment,
        book: Book,
        party: Party,
        disk_free: Callable[[], float],
        stops: StopRequests,
        live: LiveFlight | None,
    ) -> None:
        self._process_faults = ProcessFaults(experiment.inject, lambda: party.clock.now)
        self._intruder = Intruder(party)
        self._experiment, self._book, self._party = experiment, book, party
        self._disk_free, self._config = disk_free, config_id(experiment)
        keys = party.keys
        self._names = list(experiment.vehicles)
        self._at_once = False
        self._live = live
        self._truth = Subscriber(party.session, keys.truth)
        self._ticks = {n: Subscriber(party.session, keys.of(n, "tick")) for n in self._names}
        self._events = {n: Subscriber(party.session, keys.of(n, "event")) for n in self._names}
        open_tick = msgspec.msgpack.Decoder(TickReport).decode
        open_event = msgspec.msgpack.Decoder(Ended).decode
        self._flown = {n: Inbox(open_tick, party.run, LOST_S) for n in self._names}
        self._ended = {n: Inbox(open_event, party.run, LOST_S) for n in self._names}
        self._lease, self._seal = Publisher(party.session, keys.lease), Outbox(party.run)
        self._board = LocalMessages()
        lost_s = max(LOST_S, LOST_TICKS * experiment.flight.jet_period_s)
        self._nodes = {
            n: RemoteNode(n, len(experiment.vehicles[n].model.jets), self._exchange, lost_s)
            for n in self._names
        }
        states = host_states(party, self._names)
        self._links = {n: ZenohHostLink(party, n, states, self._board) for n in self._names}
        self._observer: Observer | None = None
        self._fleet: FaultReport | None = None
        self._armed = True
        self._stops = stops
        self._pause = Pause()
        self.concerns: list[Concern] = []  # of laws on the host and floods, after the flight

    @property
    def stopped(self) -> bool:
        """Whether an operator asked for a stop at any terminal."""
        return self._stops.times > 0

    def lease(self) -> None:
        """Send a lease to the vehicles, with the host data that they need."""
        now = self._party.clock.now
        faults = (replace(n.fault, vehicle=n.name) for n in self._nodes.values() if n.fault)
        fleet = self._fleet or next(faults, None)
        rehearsed = self._process_faults.found
        if rehearsed("operator_gone"):
            return
        config = "another" if rehearsed("config_differs") else self._config
        disk_free = 0.0 if rehearsed("disk_full") else self._disk_free()
        lease = Lease(self._armed, fleet, config, disk_free, self._at_once)
        self._lease.send(self._seal.seal(lease, now, now + LEASE_S))

    def fly(self, observer: Observer, stopped: Callable[[], int], supervisor: Supervisor) -> Ending:
        """Fly to the end, to a fault, or until `stopped()`."""
        experiment, clock = self._experiment, self._party.clock
        period, nodes, hosts = experiment.flight.jet_period_s, self._nodes.values(), self._hosts()
        self._observer = observer
        stops = StopCount(stopped, self._stops)
        ticking: Clock = clock
        with ExitStack() as stack:
            if self._live is not None:
                far = [RemoteLaw(self._party, name) for name in self._names]
                ticking = stack.enter_context(
                    self._live.flying(clock, hosts or far, hosts, supervisor, far=not hosts)
                )
            stack.enter_context(realtime_priority(PRIORITY))
            silent_s = vehicle_silent_s(experiment.table, experiment.flight)
            ending = fly(
                ticking, list(nodes), hosts, period, experiment.ticks, self,
                silent_s=silent_s, stopped=stops,
            )  # fmt: skip
        holding = holds(experiment, ending) and not stops()
        if holding:
            self._hold(stops)
        if ending.t < experiment.end_s or holding:
            self._armed, self._at_once = False, stops() > 1
            self.lease()
            reason = ending.fault.words if ending.fault else "the host has ended the flight"
            self._stop_all(reason, at_once=self._at_once)
        self._await_ends(stops)
        self._book.note_host(
            clock.lateness, sum(link.setpoints.outbox.sent for link in self._links.values())
        )
        self.concerns = self._concerns_of(hosts)
        fault = self._cause_of(ending.fault)
        if fault is None and self._stops.times and not holding:
            fault = FaultReport(FaultId.STOPPED, "stopped by the operator")
        return replace(ending, fault=fault)

    def _hosts(self) -> list[ForkedHost]:
        """The laws that run in this process."""
        experiment = self._experiment
        names = self._names if experiment.deploy.law == "host" else ()
        spoilt = self._process_faults.spoilt if experiment.inject else None
        return [
            make_host(experiment, name, self._links[name], spoilt and partial(spoilt, name))
            for name in names
        ]

    def _concerns_of(self, hosts: Sequence[ForkedHost]) -> list[Concern]:
        """Concerns of laws on the host, and floods that the vehicles report at their end."""
        laws = [
            Concern(one.name, f"{host.name}: {one.text}")
            for host in hosts
            for one in host.guidance.concerns
        ]
        floods = [
            Concern("flooded", f"{n.name}: flooded with messages from t = {since:.1f} s on")
            for n in self._nodes.values()
            if n.ended and (since := n.ended.rows.get(FaultId.FLOODED)) is not None
        ]
        return laws + floods

    def _cause_of(self, fault: FaultReport | None) -> FaultReport | None:
        """The fault, or the one of a vehicle, a law or the host itself that has caused it."""
        late = self._late_fault()
        fault = fault or late
        if fault is None:
            return None
        if late and late.id == FaultId.FLOODED:
            fault = late
        if slow := [one.text for one in self.concerns if one.name == "slow_law"]:
            # late setpoints look like a link fault
            fault = replace(fault, notes=(*fault.notes, slow[0]))
        if fault.id != FaultId.VEHICLE_SILENT:
            return self._pause.blamed(fault)
        silent = self._nodes[fault.vehicle]
        if silent.ended and silent.ended.fault:
            report = f"its last report: {silent.ended.fault.words}"
            fault = replace(fault, notes=(*fault.notes, report))
        received_until_pause = self._pause.began_s - silent.received_at < 0.5 * silent.lost_s
        return self._pause.blamed(fault) if received_until_pause else fault

    def _exchange(self, armed: bool, fleet: FaultReport | None) -> None:
        """Receive from all vehicles; the loop's data for them goes into the next lease."""
        self._armed, self._fleet = armed, fleet
        self._pause.turn_begins(self._party.clock.now)
        self._listen()

    def _late_fault(self) -> FaultReport | None:
        """A fault that only a vehicle's final report contains."""
        return next(
            (n.ended.fault for n in self._nodes.values() if n.ended and n.ended.fault), None
        )

    def vehicle(self, name: str, tick: AnyTick) -> None:
        """See `Observer`."""

    def host(self, name: str, tick: AnyHostTick) -> None:
        """See `Observer`."""
        assert self._observer is not None
        self._observer.host(name, tick)

    def done(self, t: float) -> None:
        """See `Observer`."""
        self._pause.turn_ends()
        self._process_faults.at_host()
        self.lease()
        if intruder := self._process_faults.found("foreign_session"):
            self._intruder.intrude(intruder.vehicle)
        if flood := self._process_faults.found("flood"):
            self._intruder.flood(
                flood.vehicle, round(flood.size * self._experiment.flight.jet_period_s)
            )
        self._board.tick += 1
        clock = self._party.clock
        late = clock.lateness[-1] if clock.lateness else 0.0
        self._book.note_loop(late, max(0.0, clock.now - t - late))
        assert self._observer is not None
        self._observer.done(t)

    def _listen(self) -> None:
        clock, book = self._party.clock, self._book
        poses = newest_truth(self._truth.received())
        if poses is not None:
            book.note_truth({n: poses[n] for n in self._names if n in poses})
        for name, subscriber in self._ticks.items():
            for at, data in subscriber.received():
                box = self._flown[name]
                if box.take(data, clock.of(at)) is Acceptance.TAKEN and box.newest is not None:
                    node = self._nodes[name]
                    node.received_at, node.newest = clock.of(at), box.newest.tick
                    # a stop may reach a vehicle only, or much sooner
                    self._stops.at_least(box.newest.stops, box.newest.stop_marks)
                    book.note_tick(name, box.newest)
                    assert self._observer is not None
                    self._observer.vehicle(name, box.newest.tick)
        for name, subscriber in self._events.items():
            for at, data in subscriber.received():
                end = self._ended[name]
                if end.take(data, clock.of(at)) is Acceptance.TAKEN and end.newest is not None:
                    book.note_end(name, end.newest)
                    self._nodes[name].ended = end.newest

    def _stop_all(self, reason: str, *, at_once: bool = False) -> None:
        for name in self._names:
            if self._nodes[name].ended is not None:
                continue
            try:
                order(self._party.session, self._party.keys, name, Stop(reason, at_once))
            except NetworkError:
                continue  # it is lost, and its board's watchdog has closed the valves

    def _hold(self, stops: Callable[[], int]) -> None:
        """Let the vehicles hold position until a stop, a fault of one of them, or the time."""

        def over() -> bool:
            nodes = self._nodes.values()
            return stops() > 0 or not all(map(self._comes_to_rest, nodes))

        self._listen_until(self._experiment.flight.ending.hold_s, over)

    def _await_ends(self, stops: Callable[[], int]) -> None:
        """Receive until the vehicles are at rest; a silent vehicle is not waited for."""

        def over() -> bool:
            if stops() > 1 and not self._at_once:
                self._at_once = True
                self.lease()
                self._stop_all("the operator stopped twice", at_once=True)
            return not any(map(self._comes_to_rest, self._nodes.values()))

        self._listen_until(WAIT_S + self._experiment.flight.ending.brake_s, over)

    def _listen_until(self, longest: float, over: Callable[[], bool]) -> None:
        """Receive and renew leases until `over()`, or for `longest` [s]."""
        end, lease_at = monotonic_ns() + round(1e9 * longest), monotonic_ns()
        self._listen()
        while monotonic_ns() < end and not over():
            if monotonic_ns() >= lease_at:
                lease_at = monotonic_ns() + LEASE_NS
                self.lease()
            sleep_until_ns(monotonic_ns() + LOOK_NS)
            self._listen()

    def _comes_to_rest(self, node: RemoteNode) -> bool:
        return (
            node.ended is None and self._party.clock.now - node.received_at <= node.lost_s + WORDS_S
        )
