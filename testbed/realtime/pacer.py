"""Slows a flight on the twin down for viewing: virtual time follows the wall clock."""

import time
from collections.abc import Callable

from testbed.core.ports import Clock


class PacedClock:
    """Clock that waits for the wall clock, then for the clock that it wraps.

    Deadlines are absolute, so one late tick does not delay the next.
    """

    def __init__(
        self,
        clock: Clock,
        speed: float,
        now: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,  # noqa: TID251  (it is a Clock)
    ) -> None:
        """Run at `speed` times real time."""
        self._clock, self._speed, self._now, self._sleep = clock, speed, now, sleep
        self._begun: float | None = None
        self._woke = 0.0
        self.late_s = 0.0  # delay of the newest tick's start, read after waking [s]

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
    def began_ns(self) -> int | None:
        """UTC at time 0 of the run; None before its first tick [ns]."""
        if self._begun is None:
            return None
        return time.time_ns() - round(1e9 * (self._now() - self._begun))

    @property
    def busy_s(self) -> float:
        """Time since the newest tick began [s]."""
        return self._now() - self._woke
