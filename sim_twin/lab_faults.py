"""Poses as broken cameras show them: late, moved, turned."""

from collections import deque

from testbed.core.se2 import wrap
from testbed.core.types import PoseSample

LONGEST_DELAY = 3.0  # of poses that `Late` keeps [s]


class Late:
    """A body's poses that come late, with stamps as if they did not."""

    def __init__(self) -> None:
        self._seen: deque[PoseSample] = deque()
        self._last: PoseSample | None = None

    def pose(self, now: PoseSample, delay: float) -> PoseSample | None:
        """The pose that was true `delay` before, with this one's stamp; None: it was lost."""
        self._seen.append(now)
        while now.captured_at - self._seen[0].captured_at > LONGEST_DELAY:
            self._seen.popleft()
        if delay == 0.0:
            return now
        due = now.captured_at - delay
        old = [one for one in self._seen if one.captured_at <= due]
        then = old[-1] if old else now  # before the flight it was at rest
        if then is self._last:
            return None
        self._last = then
        return PoseSample(now.captured_at, then.x, then.y, then.theta)


def moved(sample: PoseSample, dx: float, dy: float) -> PoseSample:
    """A pose elsewhere [m]."""
    return PoseSample(sample.captured_at, sample.x + dx, sample.y + dy, sample.theta)


def turned(sample: PoseSample, turn: float) -> PoseSample:
    """A pose with another heading [rad]."""
    return PoseSample(sample.captured_at, sample.x, sample.y, wrap(sample.theta + turn))
