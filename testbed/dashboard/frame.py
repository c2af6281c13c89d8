"""Divides the rows of a log into frames of flight time, each drawn as one picture.

A frame ends with the row of /truth that ends a tick, FRAME_S or more after the last frame. So
frames depend only on the order of the log, not on how many rows a reader gets at once: a live
flight and its replay have the same frames.
"""

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from testbed.logs.feed import News
from testbed.logs.truth import Truth

FRAME_S = 0.1  # flight time between two pictures
EARLY_S = 1e-6  # tolerance: times of ticks are sums of periods


class Frame(NamedTuple):
    """The rows since the last frame."""

    t: float  # [s]
    news: list[News]


class Frames:
    """Divides a log into frames."""

    def __init__(self) -> None:
        self._open: list[News] = []
        self._due = 0.0  # earliest end of the next frame [s]
        self._t = 0.0  # newest row so far [s]

    def cut(self, news: Iterable[News]) -> Iterator[Frame]:
        """Frames that these rows complete."""
        for one in news:
            self._open.append(one)
            self._t = max(self._t, one.t)
            if isinstance(one.message, Truth) and one.message.t >= self._due - EARLY_S:
                yield self._close(one.message.t)

    def rest(self) -> Iterator[Frame]:
        """The last, incomplete frame, at the end of the log."""
        if self._open:
            yield self._close(self._t)

    def _close(self, t: float) -> Frame:
        self._due = (math.floor(t / FRAME_S + EARLY_S) + 1) * FRAME_S
        frame, self._open = Frame(t, self._open), []
        return frame
