"""Plane geometry: angles, and rotations between the table frame W and the body frame B."""

import math

from testbed.core.compiled import compiled


def wrap(angle: float) -> float:
    """The same angle in [-pi, pi)."""
    turned = (angle + math.pi) % (2.0 * math.pi) - math.pi
    return turned if turned < math.pi else -math.pi  # just below -pi the remainder rounds up


wrap_compiled = compiled(wrap)


def to_body(theta: float, x_w: float, y_w: float) -> tuple[float, float]:
    """Rotate a vector from W to the frame B of a body with heading `theta` [rad]."""
    c, s = math.cos(theta), math.sin(theta)
    return c * x_w + s * y_w, -s * x_w + c * y_w


def to_table(theta: float, x_b: float, y_b: float) -> tuple[float, float]:
    """Rotate a vector from B to W."""
    c, s = math.cos(theta), math.sin(theta)
    return c * x_b - s * y_b, s * x_b + c * y_b
