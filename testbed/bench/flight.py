"""The flight as the host sees it: its laws, the permit, and what the vehicles report."""

import math
from collections.abc import Callable
from typing import Protocol

import msgspec
import zenoh

from testbed.config import Experiment
from testbed.core.types import HostTick, Tick
from testbed.flight.agent import lead_time
from testbed.flight.loop import Ending, HostNode, Observer, fly
from testbed.ops.network.envelope import Inbox, Outbox, Verdict
from testbed.ops.network.keys import Keys
from testbed.ops.network.links import Blackboard, Party, ZenohHostLink, host_states
from testbed.ops.network.orders import Answer, Ended, Flown, Order, Permit, Stop
from testbed.ops.network.session import Ear, Mouth, NetworkError, ask, on_word
from testbed.ops.steady import preferred
from testbed.ops.ticking import monotonic_ns, sleep_until_ns
from testbed.rig import make_guidance

PRIORITY = 10  # below the vehicles: they hold the valves
PERMIT_S = 0.35  # a vehicle may miss three
LOST_S = 1.0  # a vehicle that is not heard for so long is gone
WAIT_S = 3.0  # for the vehicles' last words
LOOK_NS = 20_000_000


class Book(Protocol):
    """Who notes what becomes known of a flight."""

    def note_truth(self, poses: dict[str, list[float]]) -> None:
        """The newest truth."""
        ...

    def note_tick(self, name: str, flown: Flown) -> None:
        """A vehicle's tick."""
        ...

    def note_end(self, name: str, ended: Ended) -> None:
        """A vehicle's last words."""
        ...

    def note_host(self, lateness: list[float], sent: int) -> None:
        """How the host kept its time."""
        ...


def order(session: zenoh.Session, keys: Keys, name: str, what: Order) -> Answer:
    """A vehicle's answer to an order."""
    data = ask(session, keys.of(name, "order"), msgspec.msgpack.encode(what))
    try:
        answer: Answer = msgspec.msgpack.decode(data, type=Answer)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        raise NetworkError(f"{name} answers an order with what is no answer") from None
    return answer


_open_truth = msgspec.msgpack.Decoder(tuple[int, dict[str, list[float]]]).decode


def newest_truth(told: list[tuple[int, bytes]]) -> tuple[dict[str, list[float]] | None, int]:
    """The newest of some messages of the truth that is one, and how many were none."""
    bad = 0
    for _, data in reversed(told):
        try:
            poses = _open_truth(data)[1]
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
            bad += 1
            continue
        if all(len(row) == 6 and all(map(math.isfinite, row)) for row in poses.values()):
            return poses, bad
        bad += 1
    return None, bad


class HostFlight:
    """One flight."""

    def __init__(self, experiment: Experiment, book: Book, party: Party) -> None:
        self._experiment, self._book, self._party = experiment, book, party
        keys = party.keys
        self._names = list(experiment.vehicles)
        self.truth: Ear | None = None
        self.bad_truth = 0  # messages of it that were none
        self._ticks = {n: Ear(party.session, keys.of(n, "tick")) for n in self._names}
        self._events = {n: Ear(party.session, keys.of(n, "event")) for n in self._names}
        open_tick = msgspec.msgpack.Decoder(Flown).decode
        open_event = msgspec.msgpack.Decoder(Ended).decode
        self._flown = {n: Inbox(open_tick, party.run, LOST_S) for n in self._names}
        self._ended = {n: Inbox(open_event, party.run, LOST_S) for n in self._names}
        self._permit, self._seal = Mouth(party.session, keys.permit), Outbox(party.run)
        self._board = Blackboard()
        self._heard_at = dict.fromkeys(self._names, 0.0)
        self.fault: str | None = None
        states = host_states(party, self._names)
        self._links = {n: ZenohHostLink(party, n, states, self._board) for n in self._names}
        self._observer: Observer | None = None
        self._stopped = False
        self._stop_key = on_word(party.session, keys.stop, self._stop)

    def _stop(self) -> None:
        self._stopped = True

    def fly(self, observer: Observer, stopped: Callable[[], bool]) -> Ending:
        """Fly to the end, to a fault, or until `stopped()`."""
        clock, experiment = self._party.clock, self._experiment
        period = experiment.flight.jet_period_s
        hosts = [
            HostNode(
                name, make_guidance(experiment, name), self._links[name], period,
                lead_time(experiment.vehicles[name].model),
            )
            for name in self._names
            if experiment.deploy.law == "host"
        ]  # fmt: skip
        self._observer = observer
        with preferred(PRIORITY):
            ending = fly(
                clock, [], hosts, period, experiment.ticks, self,
                stopped=lambda: stopped() or self._over(),
            )  # fmt: skip
        early = ending.t < experiment.ticks * period
        if early:
            self._stop_all(self.fault or "the host has ended the flight")
        self._await_ends()
        self._book.note_host(
            clock.lateness, sum(link.said.outbox.sent for link in self._links.values())
        )
        return Ending(ending.t, self.fault)

    def vehicle(self, name: str, tick: Tick) -> None:
        """See `Observer`."""

    def host(self, name: str, tick: HostTick) -> None:
        """See `Observer`."""
        assert self._observer is not None
        self._observer.host(name, tick)

    def done(self, t: float) -> None:
        """See `Observer`."""
        now = self._party.clock.now
        self._permit.say(self._seal.seal(Permit(), now, now + PERMIT_S))
        self._board.tick += 1
        self._listen()
        assert self._observer is not None
        self._observer.done(t)

    def _listen(self) -> None:
        clock, book = self._party.clock, self._book
        if self.truth is not None and (told := self.truth.heard()):
            poses, bad = newest_truth(told)
            self.bad_truth += bad
            if poses is not None:
                book.note_truth({n: poses[n] for n in self._names if n in poses})
        for name, ear in self._ticks.items():
            for at, data in ear.heard():
                box = self._flown[name]
                if box.take(data, clock.of(at)) is Verdict.TAKEN and box.newest is not None:
                    self._heard_at[name] = clock.of(at)
                    book.note_tick(name, box.newest)
                    assert self._observer is not None
                    self._observer.vehicle(name, box.newest.tick)
        for name, ear in self._events.items():
            for at, data in ear.heard():
                end = self._ended[name]
                if end.take(data, clock.of(at)) is Verdict.TAKEN and end.newest is not None:
                    book.note_end(name, end.newest)
                    if end.newest.fault is not None and self.fault is None:
                        self.fault = end.newest.fault

    def _over(self) -> bool:
        """Whether a vehicle has ended, is gone, or somebody said stop."""
        if self._stopped and self.fault is None:
            self.fault = "stopped by the operator"
        if self.fault is None:
            now = self._party.clock.now
            gone = [n for n, at in self._heard_at.items() if now - at > LOST_S]
            if gone:
                silent = now - self._heard_at[gone[0]]
                self.fault = f"{gone[0]}: not heard for {silent:.1f} s"
        return self.fault is not None

    def _stop_all(self, reason: str) -> None:
        for name in self._names:
            if self._ended[name].newest is not None:
                continue
            try:
                order(self._party.session, self._party.keys, name, Stop(reason))
            except NetworkError:
                continue  # it is gone, and its board's watchdog has closed the valves

    def _await_ends(self) -> None:
        end = monotonic_ns() + round(1e9 * WAIT_S)
        while monotonic_ns() < end and any(e.newest is None for e in self._ended.values()):
            sleep_until_ns(monotonic_ns() + LOOK_NS)
            self._listen()
