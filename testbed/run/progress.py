"""Progress of a flight, as one line on stderr."""

import sys

from testbed.run.fly import FlightScreen

EVERY_S = 1.0  # flight time between updates [s]


class Progress(FlightScreen):
    """A progress line that is rewritten in place.

    Args:
        duration_s: duration of the flight [s].
    """

    def __init__(self, duration_s: float) -> None:
        self._duration, self._next = duration_s, 0.0

    def flies(self) -> None:
        """See `FlightScreen`."""
        self._show(0.0)

    def done(self, t: float) -> None:
        """See `FlightScreen`."""
        if t >= self._next:
            self._next = t + EVERY_S
            self._show(t)
        if t >= self._duration - 1e-6:
            sys.stderr.write("\n")

    def warn(self, line: str) -> None:
        """See `FlightScreen`."""
        sys.stderr.write(f"\n{line}\n")

    def _show(self, t: float) -> None:
        sys.stderr.write(f"\rflown {t:.0f} of {self._duration:.0f} s")
        sys.stderr.flush()
