"""The only module that reads and waits for wall-clock time.

Deadlines are absolute: a late tick does not delay the next one. The lateness of a tick is read
after waking.
"""

import time


def monotonic_ns() -> int:
    """This machine's monotonic clock [ns]; the same for all processes on it."""
    return time.monotonic_ns()


def boot_ns() -> int:
    """The same clock, but it also counts while this machine is suspended [ns]."""
    return time.clock_gettime_ns(time.CLOCK_BOOTTIME)


def monotonic_of_wall(wall_ns: int) -> int:
    """Convert the kernel's wall clock, which stamps datagrams, to the monotonic clock [ns]."""
    return wall_ns - time.clock_gettime_ns(time.CLOCK_REALTIME) + time.monotonic_ns()


def sleep_until_ns(deadline: int) -> int:
    """Sleep until this time of the monotonic clock; returns the lateness [ns]."""
    while (left := deadline - time.monotonic_ns()) > 0:
        time.sleep(left * 1e-9)  # noqa: TID251  (this is the wall clock)
    return -left


class WallClock:
    """The `Clock` of a run on the bench or the table.

    Args:
        epoch_ns: the run's time 0 on this machine's monotonic clock.
    """

    def __init__(self, epoch_ns: int) -> None:
        self.epoch_ns = epoch_ns
        self.lateness: list[float] = []  # lateness of every wait, read after waking [s]

    @property
    def now(self) -> float:
        """Time of the run [s]."""
        return 1e-9 * (time.monotonic_ns() - self.epoch_ns)

    @property
    def began_ns(self) -> int:
        """UTC at time 0 of the run [ns]."""
        return time.time_ns() - time.monotonic_ns() + self.epoch_ns

    def of(self, monotonic: int) -> float:
        """Convert a time of the monotonic clock to the run's time [s]."""
        return 1e-9 * (monotonic - self.epoch_ns)

    def wait_until(self, t: float) -> None:
        """See `Clock`."""
        self.lateness.append(1e-9 * sleep_until_ns(self.epoch_ns + round(t * 1e9)))


class MonotonicClock:
    """The `Timer` of a plug-in: this machine's monotonic clock, in seconds."""

    @property
    def now(self) -> float:
        """See `Timer`."""
        return 1e-9 * time.monotonic_ns()

    def wait_until(self, t: float) -> None:
        """See `Clock`."""
        sleep_until_ns(round(1e9 * t))
