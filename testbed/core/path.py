"""Where a goal that moves is: for a leader, or for a vehicle that follows a line or a circle."""

import math
from typing import NamedTuple

from msgspec import Struct

from testbed.core.vehicle import Point, Positive


class Moved(NamedTuple):
    """How far a goal has moved from where the experiment puts it, and how it goes on."""

    p: Point  # [m]
    v: Point  # [m/s]
    a: Point  # [m/s^2]
    jerk: Point  # [m/s^3]


class Line(Struct, frozen=True, forbid_unknown_fields=True, tag="line"):
    """Straight on at constant velocity."""

    velocity: Point  # [m/s]

    def at(self, t: float) -> Moved:
        """Movement since the start of the run, at time `t` [s]."""
        vx, vy = self.velocity
        return Moved((t * vx, t * vy), self.velocity, (0.0, 0.0), (0.0, 0.0))


class Circle(Struct, frozen=True, forbid_unknown_fields=True, tag="circle"):
    """Round and round, counter-clockwise; the goal of the experiment is where it starts."""

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


Path = Line | Circle
