"""A flight on the twin at a pace to look at: virtual time that keeps step with the wall clock."""

import time
from collections.abc import Callable

from testbed.core.ports import Clock


class Pace:
    """Clock that waits for the wall clock, then for the clock it goes round.

    Deadlines are absolute, so what one tick is late the next is not.
    """

    def __init__(
        self,
        clock: Clock,
        speed: float,
        now: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,  # noqa: TID251  (it is a Clock)
    ) -> None:
        """`speed` times as fast as real time."""
        self._clock, self._speed, self._now, self._sleep = clock, speed, now, sleep
        self._begun: float | None = None
        self._woke = 0.0
        self.late_s = 0.0  # the newest tick began so much after its time, read after waking

    def wait_until(self, t: float) -> None:
        """See `Clock`."""
        if self._begun is None:
            self._begun = self._now() - t / self._speed
        due = self._begun + t / self._speed
        while (left := due - self._now()) > 0.0:
            self._sleep(left)
        self._woke = self._now()
        self.late_s = self._woke - due
        self._clock.wait_until(t)

    @property
    def busy_s(self) -> float:
        """Since the newest tick began."""
        return self._now() - self._woke
