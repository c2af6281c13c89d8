"""Counting the operator's stop requests."""

from collections.abc import Callable

from testbed.realtime.wall_clock import monotonic_ns

AGAIN_NS = 500_000_000  # copies of one stop arrive by several routes within this time


class Asked:
    """Counts stops: 1 is brake and land, 2 is shut valves and air at once."""

    def __init__(self, now: Callable[[], int] = monotonic_ns) -> None:
        self._now = now
        self._first: int | None = None
        self.times = 0

    def hear(self) -> int:
        """Count a stop; returns the number so far."""
        now = self._now()
        if self._first is None:
            self._first, self.times = now, 1
        elif now - self._first > AGAIN_NS:
            self.times = 2
        return self.times

    def insist(self) -> None:
        """Count a stop that demands an immediate shutdown."""
        if self._first is None:
            self._first = self._now()
        self.times = 2
