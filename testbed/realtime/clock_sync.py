"""What another machine's clock shows, estimated from stamped messages. Pure.

A question and its answer bound the difference between the clocks to half of the time they took; the
quickest exchange of late is believed, as in NTP (D. L. Mills, "Internet time synchronization: the
network time protocol", IEEE Transactions on Communications 39(10), 1991). Without answers there is
only the message that travelled fastest: its travel time is then a part of the offset.
"""

from collections import deque
from typing import NamedTuple

REMEMBERED = 32  # exchanges; clocks drift apart, so an old one is forgotten


class Reading(NamedTuple):
    """One reading of the other clock."""

    offset_ns: float  # other clock minus own
    delay_ns: float  # of question and answer together


class ClockOffset:
    """The other clock, seen from here."""

    def __init__(self) -> None:
        self._readings: deque[Reading] = deque(maxlen=REMEMBERED)
        self._earliest: deque[float] = deque(maxlen=REMEMBERED)
        self._best: Reading | None = None  # of the readings

    def exchanged(self, asked_ns: int, other_ns: float, answered_ns: int) -> None:
        """A question at `asked_ns`, the other clock in the answer, which came at `answered_ns`."""
        delay = answered_ns - asked_ns
        if delay >= 0:
            self._readings.append(Reading(other_ns - 0.5 * (asked_ns + answered_ns), delay))
            self._best = min(self._readings, key=lambda r: r.delay_ns)

    def heard(self, sent_ns: float, arrived_ns: int) -> None:
        """A message with the other clock in it."""
        self._earliest.append(sent_ns - arrived_ns)

    @property
    def best(self) -> Reading | None:
        """The best reading there is; None before the first. Delay -1: it is not known."""
        if self._best is not None:
            return self._best
        if self._earliest:
            return Reading(max(self._earliest), -1.0)
        return None

    def to_own(self, other_ns: float) -> int | None:
        """A time of the other clock on the own one."""
        best = self.best
        return None if best is None else round(other_ns - best.offset_ns)
