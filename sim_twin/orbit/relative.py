r"""Motion relative to a point on an elliptic orbit (the chief), nonlinear.

Source: Eq. (1) of X. Xue, X. Yue, J. Yuan, "Connectivity preservation and collision avoidance
control for spacecraft formation flying in the presence of multiple obstacles", Advances in Space
Research 67, 2021, and of X. Xue, X. Wang, N. Han, Aerospace 11:612, 2024; Eq. (1)-(3) of J. Zhang,
Y. Wang, et al., Electronics 12:3179, 2023, are the same motion.

    p'' = g(p) + C p' + f / m                                                         Eq. (1)
    C   = 2 th' [[0, 1, 0], [-1, 0, 0], [0, 0, 0]]
    g   = [[th'^2, th'', 0], [-th'', th'^2, 0], [0, 0, 0]] p - mu p / r^3
          + mu (1 / rc^2 - rc / r^3, 0, 0),           r = |(rc + x, y, z)|

    paper        code                 meaning                                        unit
    p = x, y, z  p                    radial, along-track, normal                    m
    rc, rc'      radius, climb        the chief's distance from the centre           m, m/s
    th', th''    spin, spin_rate      turn rate of the frame, its derivatives        rad/s, ...

Differences from the papers: both papers of Xue print g with the opposite sign, valid on the
left-hand side (tests/orbit compares with inertial motion). The difference of the two large terms
is computed in Encke's form, which avoids cancellation.
"""

from typing import NamedTuple

import numpy as np

from sim_twin.orbit.kepler import Orbit, mean_of_true, true_of_mean
from testbed.core.compiled import compiled


class Chief(NamedTuple):
    """The reference orbit, for compiled code."""

    mu: float  # [m^3/s^2]
    momentum: float  # h [m^2/s]
    e: float  # [-]
    mean_motion: float  # [rad/s]
    mean_anomaly: float  # at time 0 [rad]


class Frame(NamedTuple):
    """The chief and its frame at one instant."""

    mu: float  # [m^3/s^2]
    radius: float  # rc [m]
    climb: float  # rc' [m/s]
    spin: float  # th' [rad/s]
    spin_rate: float  # th'' [rad/s^2]
    spin_jerk: float  # th''' [rad/s^3]


def chief_on(orbit: Orbit) -> Chief:
    """The chief on `orbit`, as compiled code needs it."""
    start = mean_of_true(orbit.theta, orbit.e)
    return Chief(orbit.mu, orbit.momentum, orbit.e, orbit.mean_motion, start)


@compiled
def frame_of_anomaly(chief, theta):
    """The frame where the chief's true anomaly is `theta` [rad]."""
    radius = chief.momentum**2 / chief.mu / (1.0 + chief.e * np.cos(theta))
    climb = chief.mu / chief.momentum * chief.e * np.sin(theta)
    spin = chief.momentum / radius**2
    spin_rate = -2.0 * climb * spin / radius
    fall = radius * spin**2 - chief.mu / radius**2  # rc''
    spin_jerk = (
        -2.0 * (fall * spin + climb * spin_rate) / radius + 2.0 * climb**2 * spin / radius**2
    )
    return Frame(chief.mu, radius, climb, spin, spin_rate, spin_jerk)


@compiled
def frame_at(chief, t):
    """The frame at time `t` [s]."""
    return frame_of_anomaly(
        chief, true_of_mean(chief.mean_anomaly + chief.mean_motion * t, chief.e)
    )


@compiled
def field(frame, p):
    """The term g of Eq. (1), which depends on the position `p`, shape (3,) [m/s^2]."""
    x, y, z = p[0], p[1], p[2]
    rc, mu = frame.radius, frame.mu
    q = (2.0 * rc * x + x * x + y * y + z * z) / (rc * rc)  # (r / rc)^2 - 1
    cube = (1.0 + q) ** 1.5  # (r / rc)^3
    shrink = q * (3.0 + 3.0 * q + q * q) / ((1.0 + cube) * cube)  # 1 - (rc / r)^3, Encke
    point = mu / (rc * rc * rc * cube)
    out = np.empty(3)
    out[0] = frame.spin**2 * x + frame.spin_rate * y - point * x + mu / (rc * rc) * shrink
    out[1] = frame.spin**2 * y - frame.spin_rate * x - point * y
    out[2] = -point * z
    return out


@compiled
def coriolis(frame, v):
    """The term C p' of Eq. (1), shape (3,) [m/s^2]."""
    out = np.zeros(3)
    out[0] = 2.0 * frame.spin * v[1]
    out[1] = -2.0 * frame.spin * v[0]
    return out


@compiled
def drift(frame, p, v):
    """Acceleration without thrust, g + C p', shape (3,) [m/s^2]."""
    return field(frame, p) + coriolis(frame, v)


@compiled
def drift_rate(frame, p, v, a):
    """Time derivative of the drift along a trajectory, shape (3,) [m/s^3].

    Args:
        frame: at that time.
        p: position, shape (3,) [m].
        v: velocity, shape (3,) [m/s].
        a: acceleration, drift and thrust together, shape (3,) [m/s^2].
    """
    mu, rc, climb = frame.mu, frame.radius, frame.climb
    w, w1, w2 = frame.spin, frame.spin_rate, frame.spin_jerk
    x, y, z = p[0], p[1], p[2]
    r2 = (rc + x) ** 2 + y * y + z * z
    r3 = r2 * np.sqrt(r2)
    stretch = 3.0 * ((rc + x) * (climb + v[0]) + y * v[1] + z * v[2]) / r2  # 3 r' / r
    out = np.empty(3)
    for i in range(3):
        out[i] = -mu * (v[i] - stretch * p[i]) / r3
    out[0] += -2.0 * mu * climb / rc**3 - mu * (climb - stretch * rc) / r3
    out[0] += 2.0 * w * w1 * x + w2 * y + w * w * v[0] + w1 * v[1]
    out[1] += 2.0 * w * w1 * y - w2 * x + w * w * v[1] - w1 * v[0]
    out[0] += 2.0 * (w1 * v[1] + w * a[1])
    out[1] -= 2.0 * (w1 * v[0] + w * a[0])
    return out


@compiled
def drift_all(frame, p, v, out):
    """Write the drift of each of n satellites; `p`, `v`, `out` of shape (n, 3)."""
    for i in range(p.shape[0]):
        out[i] = drift(frame, p[i], v[i])
