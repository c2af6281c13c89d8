r"""zhang2023: s and sigma along a flight, and their rates of convergence.

    s     = lambda nabla U + e'                     Eq. (15)
    sigma = s + beta^-1 s'^(p/q)                    Eq. (24)

With convergence in finite time each further decade takes less time; with exponential convergence
all decades take the same time.

Implemented with arrays, independently of `controllers.potential`, so that errors there show here.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.potential import Potential, diagonal, potential
from controllers.sotsmc import SotsmcParams
from testbed.metrics.formation import settled_after

Array = NDArray[np.float64]

TOP_SPEED = 0.1  # start of the first decade of s, sigma; far above the step's error [m/s]
TOP_ERROR = 10.0  # the same for e: past the obstacles [m]
HOP = 1e-3  # step of the numerical derivative along the trajectory [s]


class Trajectory(NamedTuple):
    """A satellite's trajectory; arrays of shape (m, d), obstacles stand still."""

    t: Array  # (m,) [s]
    e: Array  # position error [m]
    p: Array  # [m]
    v: Array  # [m/s]
    a: Array  # [m/s^2]
    obstacles: Array  # (k, d) [m]
    radius: float  # of the danger areas [m]


def slope(u: Potential, way: Trajectory, hop: float = 0.0) -> Array:
    """Nabla U, Eq. (16), after `hop` seconds at the present velocity; shape (m, d) [m]."""
    step = hop * way.v
    e, p = way.e + step, way.p + step
    total = u.attract * e
    size = (u.repel * e * e).sum(axis=1, keepdims=True)
    for obstacle in way.obstacles:
        r = p - obstacle
        width = u.width_ratio * (way.radius + u.standoff)
        high = u.height * np.exp(-(r**2).sum(axis=1, keepdims=True) / width**2)
        total = total + high * u.repel * e - size * high * r / width**2
    return total


def surfaces(params: SotsmcParams, way: Trajectory) -> tuple[Array, Array]:
    """The surface s and the switching function sigma, each (m, d) [m/s]."""
    d = way.p.shape[1]
    u, gain = potential(params.potential, d), diagonal(params.surface, d)
    s = gain * slope(u, way) + way.v
    rate = gain * (slope(u, way, HOP) - slope(u, way, -HOP)) / (2.0 * HOP) + way.a
    curve = np.sign(rate) * np.abs(rate) ** (params.p / params.q)
    return s, s + curve / diagonal(params.beta, d)


def decades(t: Array, x: Array, top: float) -> float | None:
    """Time from top/10 to top/100 over that from `top` to top/10, by the last crossings."""
    ends = [settled_after(t, x > level) for level in (top, top / 10.0, top / 100.0)]
    if None in ends:
        return None
    first, second, third = (float(end or 0.0) for end in ends)
    return (third - second) / (second - first) if second > first else None


def vanishing(params: SotsmcParams, way: Trajectory) -> dict[str, float | None]:
    """Convergence of sigma, s and e, see `decades`."""
    s, sigma = surfaces(params, way)
    return {
        "sigma_decades": decades(way.t, np.linalg.norm(sigma, axis=1), TOP_SPEED),
        "surface_decades": decades(way.t, np.linalg.norm(s, axis=1), TOP_SPEED),
        "error_decades": decades(way.t, np.linalg.norm(way.e, axis=1), TOP_ERROR),
    }
