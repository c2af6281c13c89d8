"""Estimates another machine's clock from stamped messages. Pure.

A query and its answer give the clock difference to within half of their round trip; the fastest
recent exchange is used, as in NTP (D. L. Mills, "Internet time synchronization: the network time
protocol", IEEE Transactions on Communications 39(10), 1991). Without answers the fastest one-way
message is used: its travel time is then part of the offset.
"""

from collections import deque
from typing import NamedTuple

REMEMBERED = 32  # exchanges kept; clocks drift apart, so old ones are dropped


class Reading(NamedTuple):
    """One reading of the other clock."""

    offset_ns: float  # other clock minus own
    delay_ns: float  # round trip; -1: not known


class ClockOffset:
    """Offset of another clock from this machine's."""

    def __init__(self) -> None:
        self._readings: deque[Reading] = deque(maxlen=REMEMBERED)
        self._earliest: deque[float] = deque(maxlen=REMEMBERED)
        self._best: Reading | None = None  # of the readings

    def exchanged(self, asked_ns: int, other_ns: float, answered_ns: int) -> None:
        """Add an exchange: query at `asked_ns`, the other clock's time, answer at `answered_ns`."""
        delay = answered_ns - asked_ns
        if delay >= 0:
            self._readings.append(Reading(other_ns - 0.5 * (asked_ns + answered_ns), delay))
            self._best = min(self._readings, key=lambda r: r.delay_ns)

    def received(self, sent_ns: float, arrived_ns: int) -> None:
        """Add a one-way message stamped by the other clock."""
        self._earliest.append(sent_ns - arrived_ns)

    @property
    def best(self) -> Reading | None:
        """The best reading; None before the first. Delay -1: not known."""
        if self._best is not None:
            return self._best
        if self._earliest:
            return Reading(max(self._earliest), -1.0)
        return None

    def to_own(self, other_ns: float) -> int | None:
        """Convert a time of the other clock to this machine's clock."""
        best = self.best
        return None if best is None else round(other_ns - best.offset_ns)
