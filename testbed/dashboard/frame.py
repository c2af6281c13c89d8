"""Rows of a log cut into frames of flight time: what a picture at time t is made of.

A frame ends with the row of /truth that ends a tick, FRAME_S or more after the last frame. So it
depends on the order of the log alone, and not on how many rows a reader gets at once: a flight that
is followed and one that is replayed have the same frames.
"""

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from testbed.logs.feed import News
from testbed.logs.recorder import Truth

FRAME_S = 0.1  # of the flight, between two pictures
EARLY_S = 1e-6  # times of ticks are sums of periods


class Frame(NamedTuple):
    """What has come since the last frame."""

    t: float  # [s]
    news: list[News]


class Frames:
    """Cuts a log into frames."""

    def __init__(self) -> None:
        self._open: list[News] = []
        self._due = 0.0  # end of the next frame, at the earliest [s]
        self._t = 0.0  # newest row so far [s]

    def cut(self, news: Iterable[News]) -> Iterator[Frame]:
        """Frames that these rows end."""
        for one in news:
            self._open.append(one)
            self._t = max(self._t, one.t)
            if isinstance(one.message, Truth) and one.message.t >= self._due - EARLY_S:
                yield self._close(one.message.t)

    def rest(self) -> Iterator[Frame]:
        """What no row of /truth has ended: the log has come to its end."""
        if self._open:
            yield self._close(self._t)

    def _close(self, t: float) -> Frame:
        self._due = (math.floor(t / FRAME_S + EARLY_S) + 1) * FRAME_S
        frame, self._open = Frame(t, self._open), []
        return frame
