"""The host's clock before and during a flight: asked now and then, and nobody waits for the answer.

What is said is how far the clocks are apart for certain: an answer that took long says less, and a
slow network never looks like a clock that was set.
"""

from typing import Any

import zenoh

from testbed.net.keys import Keys
from testbed.net.session import NetworkError, ask
from testbed.realtime.clock_sync import ClockOffset
from testbed.realtime.wall_clock import WallClock, monotonic_ns

STAMP = 8  # [bytes] of an answer
ASK_NS = 200_000_000  # between two questions
READINGS = 16  # before a flight
READ_NS = 1_000_000_000  # the same, while a vehicle waits
UNREAD_S = 1e3  # a clock that was never read


def read_clock(session: zenoh.Session, keys: Keys) -> ClockOffset:
    """The host's clock, from some questions and answers."""
    clock = ClockOffset()
    for _ in range(READINGS):
        asked = monotonic_ns()
        said = ask(session, keys.clock)
        if len(said) != STAMP:
            raise NetworkError(f"the host's clock says {len(said)} bytes, expected {STAMP}")
        clock.exchanged(asked, int.from_bytes(said, "little"), monotonic_ns())
    return clock


class Reader:
    """Goes on reading the host's clock while a vehicle waits: in an hour clocks drift apart."""

    def __init__(self, session: zenoh.Session, keys: Keys, offset: ClockOffset) -> None:
        self._session, self._key, self._offset = session, keys.clock, offset
        self._due = 0

    def look(self) -> None:
        """Ask, if it is time to."""
        asked = monotonic_ns()
        if asked < self._due:
            return
        self._due = asked + READ_NS

        def answered(reply: Any) -> None:
            said = b"" if reply.ok is None else reply.ok.payload.to_bytes()
            if len(said) == STAMP:
                self._offset.exchanged(asked, int.from_bytes(said, "little"), monotonic_ns())

        answers = zenoh.handlers.Callback(answered, indirect=False)
        self._session.get(self._key, answers, timeout=1.0)

    def unsure(self) -> float:
        """By how much the host's clock may be misread [s]."""
        best = self._offset.best
        return UNREAD_S if best is None or best.delay_ns < 0.0 else 0.5e-9 * best.delay_ns


class HostClock:
    """Watches the host's clock against the vehicle's.

    Args:
        session: the network.
        keys: of the lab.
        clock: the run's, on this vehicle.
        epoch_ns: the run's time 0 on the host's monotonic clock.
    """

    def __init__(self, session: zenoh.Session, keys: Keys, clock: WallClock, epoch_ns: int) -> None:
        self._session, self._key = session, keys.clock
        self._clock, self._epoch_ns = clock, epoch_ns
        self._due = 0
        self._off = 0.0
        self.trip: float | None = None  # of the newest question and answer [s]

    def off(self) -> float:
        """The host's clock minus the own, as far as that is certain [s]; asks again, if due."""
        now = monotonic_ns()
        if now >= self._due:
            self._due = now + ASK_NS
            asked = self._clock.now

            def answered(reply: Any) -> None:
                said = b"" if reply.ok is None else reply.ok.payload.to_bytes()
                if len(said) == STAMP:
                    self._take(asked, int.from_bytes(said, "little"))

            answers = zenoh.handlers.Callback(answered, indirect=False)
            self._session.get(self._key, answers, timeout=1.0)
        return self._off

    def _take(self, asked: float, host_ns: int) -> None:
        now = self._clock.now
        self.trip = now - asked
        apart = 1e-9 * (host_ns - self._epoch_ns) - 0.5 * (asked + now)
        sure = abs(apart) - 0.5 * self.trip
        self._off = 0.0 if sure <= 0.0 else sure if apart > 0.0 else -sure
