"""Wall-clock time, read and waited for in one place.

Deadlines are absolute: a tick that comes late does not push the next one back. How late a tick
really began is read after waking, which is when it counts.
"""

import time


def monotonic_ns() -> int:
    """This machine's monotonic clock [ns]; the same for all processes on it."""
    return time.monotonic_ns()


def monotonic_of_wall(wall_ns: int) -> int:
    """The monotonic clock when the kernel's wall clock, which stamps datagrams, showed this."""
    return wall_ns - time.clock_gettime_ns(time.CLOCK_REALTIME) + time.monotonic_ns()


def sleep_until_ns(deadline: int) -> int:
    """Return at this time of the monotonic clock; how late it was [ns]."""
    while (left := deadline - time.monotonic_ns()) > 0:
        time.sleep(left * 1e-9)  # noqa: TID251  (this is the clock that the ban points to)
    return -left


class WallClock:
    """The `Clock` of a run on the bench or the table.

    Args:
        epoch_ns: the run's time 0 on this machine's monotonic clock.
    """

    def __init__(self, epoch_ns: int) -> None:
        self.epoch_ns = epoch_ns
        self.lateness: list[float] = []  # of every wait, read after waking [s]

    @property
    def now(self) -> float:
        """Time of the run [s]."""
        return 1e-9 * (time.monotonic_ns() - self.epoch_ns)

    def of(self, monotonic: int) -> float:
        """Time of the run at this time of the monotonic clock [s]."""
        return 1e-9 * (monotonic - self.epoch_ns)

    def wait_until(self, t: float) -> None:
        """See `Clock`."""
        self.lateness.append(1e-9 * sleep_until_ns(self.epoch_ns + round(t * 1e9)))
