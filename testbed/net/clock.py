"""The host's clock before and during a flight: queried periodically, never waited for.

The result is a lower bound of the offset: a long round trip makes the bound smaller, so a slow
network never looks like a clock that was set.
"""

from collections.abc import Callable
from typing import Any

import zenoh

from testbed.net.keys import Keys
from testbed.net.session import NetworkError, ask
from testbed.realtime.clock_sync import ClockOffset
from testbed.realtime.wall_clock import WallClock, monotonic_ns

STAMP = 8  # length of an answer [bytes]
ASK_NS = 200_000_000  # time between two queries
READINGS = 16  # queries before a flight
READ_NS = 1_000_000_000  # time between two queries while a vehicle waits
UNREAD_S = 1e3  # uncertainty of a clock that was never read


def read_clock(session: zenoh.Session, keys: Keys) -> ClockOffset:
    """Offset of the host's clock, from several queries."""
    clock = ClockOffset()
    for _ in range(READINGS):
        asked = monotonic_ns()
        answer = ask(session, keys.clock)
        if len(answer) != STAMP:
            raise NetworkError(f"the host's clock sent {len(answer)} bytes, expected {STAMP}")
        clock.exchanged(asked, int.from_bytes(answer, "little"), monotonic_ns())
    return clock


def query(session: zenoh.Session, key: str, answered: Callable[[int], None]) -> None:
    """Ask for the host's clock; `answered` gets it [ns] if an answer comes, without waiting."""

    def receive(reply: Any) -> None:
        answer = b"" if reply.ok is None else reply.ok.payload.to_bytes()
        if len(answer) == STAMP:
            answered(int.from_bytes(answer, "little"))

    session.get(key, zenoh.handlers.Callback(receive, indirect=False), timeout=1.0)


class Reader:
    """Keeps reading the host's clock while a vehicle waits, because clocks drift apart."""

    def __init__(self, session: zenoh.Session, keys: Keys, offset: ClockOffset) -> None:
        self._session, self._key, self._offset = session, keys.clock, offset
        self._due = 0

    def look(self) -> None:
        """Query the clock if a query is due."""
        asked = monotonic_ns()
        if asked >= self._due:
            self._due = asked + READ_NS
            query(
                self._session, self._key,
                lambda host_ns: self._offset.exchanged(asked, host_ns, monotonic_ns()),
            )  # fmt: skip

    def unsure(self) -> float:
        """Uncertainty of the offset to the host's clock [s]."""
        best = self._offset.best
        return UNREAD_S if best is None or best.delay_ns < 0.0 else 0.5e-9 * best.delay_ns


class HostClock:
    """Compares the host's clock with the vehicle's during a flight.

    Args:
        session: the network.
        keys: of the lab.
        clock: the run's clock on this vehicle.
        epoch_ns: the run's time 0 on the host's monotonic clock.
    """

    def __init__(self, session: zenoh.Session, keys: Keys, clock: WallClock, epoch_ns: int) -> None:
        self._session, self._key = session, keys.clock
        self._clock, self._epoch_ns = clock, epoch_ns
        self._due = 0
        self._off = 0.0
        self.trip: float | None = None  # round trip of the newest query [s]

    def off(self) -> float:
        """Lower bound of the host's clock minus this one [s]; also sends a query if one is due."""
        now = monotonic_ns()
        if now >= self._due:
            self._due = now + ASK_NS
            asked = self._clock.now
            query(self._session, self._key, lambda host_ns: self._take(asked, host_ns))
        return self._off

    def _take(self, asked: float, host_ns: int) -> None:
        now = self._clock.now
        self.trip = now - asked
        apart = 1e-9 * (host_ns - self._epoch_ns) - 0.5 * (asked + now)
        sure = abs(apart) - 0.5 * self.trip
        self._off = 0.0 if sure <= 0.0 else sure if apart > 0.0 else -sure
