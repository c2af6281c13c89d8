"""Paths of moving goals: a line, a circle, a square, or a curve through points.

A circle and a curve may also give the heading: `heading = "along"` points the vehicle's x axis the
way that the goal moves.
"""

import math
from functools import lru_cache
from itertools import pairwise
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from msgspec import Meta, Struct

from testbed.core.vehicle import NonNegative, Point, Positive


class Moved(NamedTuple):
    """Displacement of a goal from its position in the experiment, and its derivatives."""

    p: Point  # [m]
    v: Point  # [m/s]
    a: Point  # [m/s^2]
    jerk: Point  # [m/s^3]


Heading = Literal["goal", "along"]  # that of the goal in the experiment, or along the path


class Line(Struct, frozen=True, forbid_unknown_fields=True, tag="line"):
    """Straight line at constant velocity."""

    velocity: Point  # [m/s]

    def at(self, t: float) -> Moved:
        """Movement since the start of the run, at time `t` [s]."""
        vx, vy = self.velocity
        return Moved((t * vx, t * vy), self.velocity, (0.0, 0.0), (0.0, 0.0))


class Circle(Struct, frozen=True, forbid_unknown_fields=True, tag="circle"):
    """Circle, counter-clockwise; it starts at the goal of the experiment."""

    radius: Positive  # [m]
    period_s: Positive
    start_deg: float = 0.0  # direction from the centre to the start
    heading: Heading = "goal"

    def at(self, t: float) -> Moved:
        """Movement since the start of the run, at time `t` [s]."""
        w, start = 2.0 * math.pi / self.period_s, math.radians(self.start_deg)
        c, s = self.radius * math.cos(start + w * t), self.radius * math.sin(start + w * t)
        x0, y0 = self.radius * math.cos(start), self.radius * math.sin(start)
        return Moved(
            (c - x0, s - y0),
            (-w * s, w * c),
            (-w * w * c, -w * w * s),
            (w**3 * s, -(w**3) * c),
        )

    def tangent(self, t: float) -> tuple[float, float, float]:
        """Direction of the way at time `t` [rad], turn rate and its derivative."""
        rate = 2.0 * math.pi / self.period_s
        return math.radians(self.start_deg) + 0.5 * math.pi + rate * t, rate, 0.0


class Square(Struct, frozen=True, forbid_unknown_fields=True, tag="square"):
    """Square, counter-clockwise, from rest to rest along each side.

    It starts at the goal of the experiment, a corner; the first side goes along `start_deg`.
    Each side is a quintic in time with zero velocity and acceleration at its ends.
    """

    side: Positive  # [m]
    period_s: Positive  # time of a full round
    start_deg: float = 0.0

    def at(self, t: float) -> Moved:
        """Movement since the start of the run, at time `t` [s]."""
        rate = 4.0 / self.period_s
        sides, s = divmod(t * rate, 1.0)
        way = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
        speed = rate * 30.0 * (s * (1.0 - s)) ** 2
        accel = rate**2 * 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)
        jerk = rate**3 * 60.0 * (1.0 - 6.0 * s + 6.0 * s * s)
        x, y = 0.0, 0.0
        turned = math.radians(self.start_deg)
        for k in range(int(sides % 4.0) + 1):
            cx, cy = self.side * math.cos(turned), self.side * math.sin(turned)
            share = way if k == int(sides % 4.0) else 1.0
            x, y, turned = x + share * cx, y + share * cy, turned + 0.5 * math.pi
        return Moved(
            (x, y), (cx * speed, cy * speed), (cx * accel, cy * accel), (cx * jerk, cy * jerk)
        )


class Points(Struct, frozen=True, forbid_unknown_fields=True, tag="points"):
    """Smooth curve from the goal of the experiment through points, from rest to rest.

    The curve is a cubic spline over the length of the straight lines between the points. The way
    along these lines is a quintic in time, whose largest speed is `speed`; in a bend the curve is
    longer, and the goal somewhat faster. With `ramp_s` the speed along the lines is even between
    two smooth ramps.
    """

    points: Annotated[list[Point], Meta(min_length=1, max_length=1000)]  # from the goal on [m]
    speed: Positive  # [m/s]
    start_s: NonNegative = 0.0  # the goal rests until then
    ramp_s: Positive | None = None  # from rest to `speed` and back
    heading: Heading = "goal"

    def at(self, t: float) -> Moved:
        """Movement since the start of the run, at time `t` [s]."""
        curve, length = _spline(tuple(map(tuple, self.points)))
        way, v, a, jerk = self._along(t - self.start_s, length)
        p, d1, d2, d3 = (curve(way, order) for order in range(4))
        return Moved(
            _pair(p), _pair(d1 * v), _pair(d2 * v * v + d1 * a),
            _pair(d3 * v**3 + 3.0 * d2 * v * a + d1 * jerk),
        )  # fmt: skip

    def tangent(self, t: float) -> tuple[float, float, float]:
        """Direction of the way at time `t`, also at rest [rad], turn rate and its derivative."""
        curve, length = _spline(tuple(map(tuple, self.points)))
        way, v, a, _ = self._along(t - self.start_s, length)
        (x1, y1), (x2, y2), (x3, y3) = (_pair(curve(way, order)) for order in (1, 2, 3))
        square = max(x1 * x1 + y1 * y1, 1e-12)
        bend = (x1 * y2 - y1 * x2) / square
        change = (x1 * y3 - y1 * x3 - 2.0 * bend * (x1 * x2 + y1 * y2)) / square
        return math.atan2(y1, x1), bend * v, bend * a + change * v * v

    def _along(self, t: float, length: float) -> tuple[float, float, float, float]:
        """Way along the curve `t` seconds after its start, and its derivatives."""
        if self.ramp_s is not None:
            ramp = min(self.ramp_s, length / self.speed)
            end = length / self.speed + ramp
            if t > end - ramp:  # the last ramp is the first one backwards
                way, v, a, jerk = _ramp(end - t, ramp, self.speed)
                return length - way, v, -a, jerk
            return _ramp(t, ramp, self.speed)
        span = max(1.875 * length / self.speed, 1e-9)
        s = min(1.0, max(0.0, t / span))
        rate = length / span
        way = length * s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
        v = rate * 30.0 * (s * (1.0 - s)) ** 2
        a = rate / span * 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)
        jerk = rate / span**2 * 60.0 * (1.0 - 6.0 * s + 6.0 * s * s) * (0.0 < s < 1.0)
        return way, v, a, jerk


def _ramp(t: float, ramp: float, speed: float) -> tuple[float, float, float, float]:
    """Way, speed, acceleration and jerk `t` seconds after rest."""
    u = max(0.0, t / ramp)
    if u >= 1.0:
        return speed * (t - 0.5 * ramp), speed, 0.0, 0.0
    return (
        speed * ramp * u**4 * (2.5 - 3.0 * u + u * u),
        speed * u**3 * (10.0 - 15.0 * u + 6.0 * u * u),
        speed / ramp * 30.0 * (u * (1.0 - u)) ** 2,
        speed / ramp**2 * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u),
    )


def _pair(vector: np.ndarray) -> Point:
    return float(vector[0]), float(vector[1])


@lru_cache(maxsize=64)
def _spline(points: tuple[Point, ...]) -> tuple[Any, float]:
    """The curve over its length, and the length; points on top of each other count once."""
    from scipy.interpolate import CubicSpline  # takes a tenth of a second to import

    kept: list[Point] = [(0.0, 0.0)]
    kept += [b for a, b in pairwise(((0.0, 0.0), *points)) if math.dist(a, b) > 1e-9]
    if len(kept) == 1:
        kept.append((1e-9, 0.0))
    steps = [math.dist(a, b) for a, b in pairwise(kept)]
    ends = "natural" if len(kept) > 2 else "not-a-knot"
    return CubicSpline(np.cumsum([0.0, *steps]), np.array(kept), bc_type=ends), sum(steps)


Path = Line | Circle | Square | Points


def along(path: Path | None) -> Circle | Points | None:
    """The path, if it gives the heading."""
    return path if isinstance(path, Circle | Points) and path.heading == "along" else None


def heading_at(path: Path | None, fixed: float, t: float) -> float:
    """Heading of a moving goal at time `t`; `fixed` is the goal's of the experiment [rad]."""
    led = along(path)
    return fixed if led is None else led.tangent(t)[0]
