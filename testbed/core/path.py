"""Paths of moving goals: a line, a circle or a square."""

import math
from typing import NamedTuple

from msgspec import Struct

from testbed.core.vehicle import Point, Positive


class Moved(NamedTuple):
    """Displacement of a goal from its position in the experiment, and its derivatives."""

    p: Point  # [m]
    v: Point  # [m/s]
    a: Point  # [m/s^2]
    jerk: Point  # [m/s^3]


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


Path = Line | Circle | Square
