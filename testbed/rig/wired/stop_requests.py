"""Counting the operator's stop requests."""

from collections import deque
from collections.abc import Callable

from testbed.realtime.wall_clock import monotonic_ns

AGAIN_NS = 500_000_000  # copies of a stop without an id arrive by several routes within this time
KEPT = 100  # ids that are kept


class Asked:
    """Counts stops: 1 is brake and land, 2 is shut valves and air at once."""

    def __init__(self, now: Callable[[], int] = monotonic_ns) -> None:
        self._now = now
        self._first: int | None = None
        self._ids: deque[bytes] = deque(maxlen=KEPT)
        self.times = 0

    def hear(self, stop: bytes = b"") -> int:
        """Count a stop; returns the number so far.

        Args:
            stop: its id; copies of one stop have the same, however late they arrive.
        """
        if stop and stop in self._ids:
            return self.times
        self._ids.append(stop)
        now = self._now()
        if self._first is None:
            self._first, self.times = now, 1
        elif now - self._first > AGAIN_NS:
            self.times = 2
        return self.times

    def at_least(self, times: int) -> None:
        """Adopt the stops that another party has counted."""
        if times > self.times:
            self._first = self._now() if self._first is None else self._first
            self.times = times

    def insist(self) -> None:
        """Count a stop that demands an immediate shutdown."""
        self.at_least(2)
