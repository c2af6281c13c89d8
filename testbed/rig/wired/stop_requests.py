"""Counting the operator's stop requests."""

from collections import deque
from collections.abc import Callable, Sequence
from hashlib import blake2b

from testbed.realtime.wall_clock import monotonic_ns

AGAIN_NS = 500_000_000  # copies of a stop without an id arrive by several routes within this time
KEPT = 100  # ids that are kept
SHARED = 8  # newest ids that another party is told of


class StopRequests:
    """Counts stops: 1 is brake and land, 2 is shut valves and air at once."""

    def __init__(self, now: Callable[[], int] = monotonic_ns) -> None:
        self._now = now
        self._first: int | None = None
        self._ids: deque[bytes] = deque(maxlen=KEPT)
        self.times = 0

    def count(self, stop: bytes = b"") -> int:
        """Count a stop; returns the number so far.

        Args:
            stop: its id; copies of one stop have the same, however late they arrive.
        """
        mark = blake2b(stop, digest_size=8).digest() if stop else b""
        if mark and mark in self._ids:
            return self.times
        if mark:
            self._ids.append(mark)
        now = self._now()
        if self._first is None:
            self._first, self.times = now, 1
        elif now - self._first > AGAIN_NS:
            self.times = 2
        return self.times

    @property
    def marks(self) -> tuple[bytes, ...]:
        """Marks of the newest stops, 8 bytes each; `at_least` of another party takes them."""
        return tuple(self._ids)[-SHARED:]

    def at_least(self, times: int, marks: Sequence[bytes] = ()) -> None:
        """Adopt the stops that another party has counted.

        Args:
            times: their number.
            marks: of them; a copy of one that arrives here later is not one more stop.
        """
        self._ids.extend(mark for mark in marks if mark not in self._ids)
        if times > self.times:
            self._first = self._now() if self._first is None else self._first
            self.times = times

    def insist(self) -> None:
        """Count a stop that demands an immediate shutdown."""
        self.at_least(2)

    @property
    def first_ns(self) -> int | None:
        """Time of the first stop [ns]; None: there was none."""
        return self._first


class StopCount:
    """Counts stops at the own terminal and from elsewhere together, when it is called.

    A Ctrl-C and a `testbed stop` are two stops, unless they come within AGAIN_NS.

    Args:
        terminal: number of stops at the own terminal.
        requests: stops from elsewhere.
        now: the monotonic clock [ns].
    """

    def __init__(
        self,
        terminal: Callable[[], int],
        requests: StopRequests,
        now: Callable[[], int] = monotonic_ns,
    ) -> None:
        self._terminal, self._requests, self._now = terminal, requests, now
        self._first: int | None = None  # at the terminal

    def __call__(self) -> int:
        """Number of stops: 1 is brake and land, 2 is shut valves and air at once."""
        own, others = self._terminal(), self._requests.times
        if own and self._first is None:
            self._first = self._now()
        if self._first is not None and self._requests.first_ns is not None:
            apart = abs(self._requests.first_ns - self._first)
            return 2 if apart > AGAIN_NS else max(own, others)
        return max(own, others)
