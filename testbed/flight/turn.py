"""Smooth turns of a vehicle: from one heading to another, and along a path."""

import math

from testbed.core.path import Circle, Path, Points, along
from testbed.core.se2 import wrap

TURN_ACCEL = 0.1  # of a turn by hand, and to end it [rad/s^2]


class Turn:
    """Smooth turn (quintic in time) from one heading to another, the shorter way round.

    It may begin with a turn rate: that is first brought to zero.
    """

    def __init__(self, start: float, end: float, t: float, accel: float, rate: float = 0.0) -> None:
        self._first, self._rate, self._begun = start, rate, t
        self._braking = abs(rate) / TURN_ACCEL  # [s]
        start, t = start + 0.5 * rate * self._braking, t + self._braking
        self._start, self._angle, self._t = start, wrap(end - start), t
        # the quintic's peak acceleration is 10/sqrt(3) angle / span^2
        self._span = max(1e-3, math.sqrt(10.0 / math.sqrt(3.0) * abs(self._angle) / accel))
        self._end = self._quintic(1.0)

    def at(self, t: float) -> tuple[float, float, float]:
        """Heading [rad], turn rate [rad/s], angular acceleration [rad/s^2]."""
        if t < self._t and self._braking > 0.0:
            late, alpha = max(0.0, t - self._begun), -self._rate / self._braking
            rate = self._rate + alpha * late
            return self._first + 0.5 * (self._rate + rate) * late, rate, alpha
        if (s := (t - self._t) / self._span) >= 1.0:
            return self._end
        return self._quintic(max(0.0, s))

    def _quintic(self, s: float) -> tuple[float, float, float]:
        """What `at` gives after a share `s` of the time from start to end."""
        a, w = self._angle, 1.0 / self._span
        return (
            self._start + a * s**3 * (10.0 - 15.0 * s + 6.0 * s * s),
            a * w * 30.0 * (s * (1.0 - s)) ** 2,
            a * w * w * 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s),
        )


class TurnAlong:
    """Smooth turn from a heading to the direction of a path, and along it."""

    def __init__(self, start: float, path: Circle | Points, t: float, accel: float) -> None:
        self._path = path
        self._turn = Turn(start - path.tangent(t)[0], 0.0, t, accel)

    def at(self, t: float) -> tuple[float, float, float]:
        """Heading [rad], turn rate [rad/s], angular acceleration [rad/s^2]."""
        (theta, omega, alpha), off = self._path.tangent(t), self._turn.at(t)
        return theta + off[0], omega + off[1], alpha + off[2]


def turn_to(
    goal: float, path: Path | None, start: float, t: float, accel: float
) -> Turn | TurnAlong:
    """The turn from heading `start` at time `t` to that of a goal, or of its path."""
    led = along(path)
    return Turn(start, goal, t, accel) if led is None else TurnAlong(start, led, t, accel)
