"""Converts data of a motion-capture system to poses on the table. Pure.

A body on the table moves in a plane; only the heading of its attitude is kept. Heading from the
quaternion q = (x, y, z, w), after a rotation that makes the upward axis z:

    theta = atan2(2 (w z + x y), 1 - 2 (y^2 + z^2))
"""

import math
from typing import Protocol

from msgspec import Struct

from testbed.core.lab import MocapWire
from testbed.core.se2 import wrap
from testbed.core.types import Pose


class Sighting(Struct, frozen=True, gc=False):
    """One body in one exposure, in the axes of the motion-capture system."""

    position: tuple[float, float, float]  # [m]
    rotation: tuple[float, float, float, float]  # x, y, z, w
    tracked: bool


class Exposure(Struct, frozen=True, gc=False):
    """All bodies at one instant; times are of this machine's monotonic clock."""

    number: int
    exposed_ns: int  # middle of the exposure
    arrived_ns: int
    bodies: dict[str, Sighting]  # by name in the motion-capture system


class MocapSource(Protocol):
    """Interface of all motion-capture systems."""

    def poll(self) -> list[Exposure]:
        """Exposures that arrived since the last call; does not wait."""
        ...

    def close(self) -> None:
        """Close sockets and processes."""
        ...


class Axes:
    """Transformation between the cameras' frame and the table frame W."""

    def __init__(self, wire: MocapWire) -> None:
        self._y_up = wire.up == "y"
        self._x, self._y = wire.origin
        self._turn = math.radians(wire.turn_deg)
        self._cos, self._sin = math.cos(self._turn), math.sin(self._turn)

    def to_table(self, seen: Sighting) -> Pose:
        """The pose in W of a body measured by the cameras."""
        x, y, z = seen.position
        qx, qy, qz, qw = seen.rotation
        if self._y_up:  # a quarter turn about x: y goes to z, z to -y
            y = -z
            qy, qz = -qz, qy
        heading = math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
        dx, dy = x - self._x, y - self._y
        return Pose(
            self._cos * dx + self._sin * dy,
            self._cos * dy - self._sin * dx,
            wrap(heading - self._turn),
        )

    def to_cameras(self, pose: Pose, height: float = 0.1) -> Sighting:
        """The camera measurement of an upright body at a pose in W; `height` in m."""
        x = self._x + self._cos * pose.x - self._sin * pose.y
        y = self._y + self._sin * pose.x + self._cos * pose.y
        half = 0.5 * (pose.theta + self._turn)
        s, c = math.sin(half), math.cos(half)
        if self._y_up:
            return Sighting((x, height, -y), (0.0, s, 0.0, c), tracked=True)
        return Sighting((x, y, height), (0.0, 0.0, s, c), tracked=True)
