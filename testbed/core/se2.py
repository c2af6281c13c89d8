"""Plane geometry: angles, and rotations between the table frame W and the body frame B."""

import math

import numpy as np
from numpy.typing import NDArray

from testbed.core.compiled import compiled


def wrap(angle: float) -> float:
    """The same angle in [-pi, pi)."""
    turned = (angle + math.pi) % (2.0 * math.pi) - math.pi
    return turned if turned < math.pi else -math.pi  # just below -pi the remainder rounds up


wrap_compiled = compiled(wrap)


def wrap_all(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """`wrap` of each, to the last bit."""
    turned = (angles + math.pi) % (2.0 * math.pi) - math.pi
    return np.where(turned < math.pi, turned, -math.pi)


@compiled
def exact_square(value):
    """A square, and what rounding took from it (T. J. Dekker, 1971)."""
    high = 134217729.0 * value  # 2^27 + 1: the upper half of the digits
    high = high - (high - value)
    low = value - high
    square = value * value
    return square, ((high * high - square) + 2.0 * high * low) + low * low


@compiled
def length(x, y):
    """Length of a vector, rounded correctly: as `math.hypot`, which compiled code does not have.

    The C library's own differs from it, and from machine to machine, in the last bit.
    """
    size = math.sqrt(x * x + y * y)
    if not 0.0 < size < math.inf:
        return size
    a, a_rest = exact_square(max(abs(x), abs(y)))
    b, b_rest = exact_square(min(abs(x), abs(y)))
    c, c_rest = exact_square(size)
    return size + (((a - c) + b) + (a_rest + b_rest - c_rest)) / (2.0 * size)


def to_body(theta: float, x_w: float, y_w: float) -> tuple[float, float]:
    """Rotate a vector from W to the frame B of a body with heading `theta` [rad]."""
    c, s = math.cos(theta), math.sin(theta)
    return c * x_w + s * y_w, -s * x_w + c * y_w


def to_table(theta: float, x_b: float, y_b: float) -> tuple[float, float]:
    """Rotate a vector from B to W."""
    c, s = math.cos(theta), math.sin(theta)
    return c * x_b - s * y_b, s * x_b + c * y_b


to_body_compiled, to_table_compiled = compiled(to_body), compiled(to_table)


@compiled
def velocity_at(vx, vy, omega, rx, ry):
    """Velocity in W of the body's point that is at (rx, ry) [m] from its origin, in W.

    Args:
        vx, vy: velocity of the origin [m/s].
        omega: turn rate [rad/s].
        rx, ry: lever arm [m].
    """
    return vx - omega * ry, vy + omega * rx
