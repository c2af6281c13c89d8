r"""ECI <-> frames that move with a satellite (the centre), positions and velocities.

The radial frame has x away from the Earth, y along-track, z along the orbit's normal; it turns with

    omega = (r . a_n / h) x + (h / r^2) z,      a_n = the part of the centre's acceleration along z

where the first term is the rotation of the orbital plane, caused by J2 and zero for two bodies.
Other axes are given by a rotation whose rows are those axes in the radial frame:
`RADIAL` is the frame itself, `NADIR` that of gao2022 (x forward, y against the normal, z down).
"""

from typing import NamedTuple

import numpy as np

from testbed.core.compiled import compiled

RADIAL = np.eye(3)
NADIR = np.array(((0.0, 1.0, 0.0), (0.0, 0.0, -1.0), (-1.0, 0.0, 0.0)))


class Moving(NamedTuple):
    """A frame that moves with a satellite, at one instant."""

    r: np.ndarray  # position of its origin in ECI, shape (3,) [m]
    v: np.ndarray  # velocity of its origin in ECI, shape (3,) [m/s]
    axes: np.ndarray  # its axes in ECI, as rows (3, 3)
    omega: np.ndarray  # angular velocity, in its own axes [rad/s]


@compiled
def moving(r, v, a, choice):
    """The frame of a satellite at `r` with velocity `v` and acceleration `a` in ECI, each (3,).

    `choice` is `RADIAL`, `NADIR` or another rotation of the radial frame, shape (3, 3).
    """
    h = np.empty(3)
    h[0] = r[1] * v[2] - r[2] * v[1]
    h[1] = r[2] * v[0] - r[0] * v[2]
    h[2] = r[0] * v[1] - r[1] * v[0]
    r2 = r[0] ** 2 + r[1] ** 2 + r[2] ** 2
    distance = np.sqrt(r2)
    size = np.sqrt(h[0] ** 2 + h[1] ** 2 + h[2] ** 2)
    radial = np.empty((3, 3))
    for k in range(3):
        radial[0, k] = r[k] / distance
        radial[2, k] = h[k] / size
    for k in range(3):
        m, n = (k + 1) % 3, (k + 2) % 3
        radial[1, k] = radial[2, m] * radial[0, n] - radial[2, n] * radial[0, m]
    out_of_plane = a[0] * radial[2, 0] + a[1] * radial[2, 1] + a[2] * radial[2, 2]
    axes, omega = np.zeros((3, 3)), np.empty(3)
    for i in range(3):
        for k in range(3):
            for j in range(3):
                axes[i, k] += choice[i, j] * radial[j, k]
        omega[i] = choice[i, 0] * distance * out_of_plane / size + choice[i, 2] * size / r2
    return Moving(r.copy(), v.copy(), axes, omega)


@compiled
def to_relative(frame, r, v, p, q):
    """Write position `p` and velocity `q` in the moving frame from `r`, `v` in ECI; all (n, 3)."""
    axes, w = frame.axes, frame.omega
    for i in range(r.shape[0]):
        d0, d1, d2 = r[i, 0] - frame.r[0], r[i, 1] - frame.r[1], r[i, 2] - frame.r[2]
        e0, e1, e2 = v[i, 0] - frame.v[0], v[i, 1] - frame.v[1], v[i, 2] - frame.v[2]
        for k in range(3):
            p[i, k] = axes[k, 0] * d0 + axes[k, 1] * d1 + axes[k, 2] * d2
            q[i, k] = axes[k, 0] * e0 + axes[k, 1] * e1 + axes[k, 2] * e2
        q[i, 0] -= w[1] * p[i, 2] - w[2] * p[i, 1]
        q[i, 1] -= w[2] * p[i, 0] - w[0] * p[i, 2]
        q[i, 2] -= w[0] * p[i, 1] - w[1] * p[i, 0]


@compiled
def to_eci(frame, p, q, r, v):
    """Write position `r` and velocity `v` in ECI from `p`, `q` in the moving frame; all (n, 3)."""
    axes, w = frame.axes, frame.omega
    for i in range(p.shape[0]):
        e0 = q[i, 0] + w[1] * p[i, 2] - w[2] * p[i, 1]
        e1 = q[i, 1] + w[2] * p[i, 0] - w[0] * p[i, 2]
        e2 = q[i, 2] + w[0] * p[i, 1] - w[1] * p[i, 0]
        for k in range(3):
            along = axes[0, k] * p[i, 0] + axes[1, k] * p[i, 1] + axes[2, k] * p[i, 2]
            r[i, k] = frame.r[k] + along
            v[i, k] = frame.v[k] + axes[0, k] * e0 + axes[1, k] * e1 + axes[2, k] * e2


@compiled
def turned_to_eci(frame, u, out):
    """Rotate vectors `u` (n, 3), such as thrust, from the moving frame to ECI; no translation."""
    axes = frame.axes
    for i in range(u.shape[0]):
        for k in range(3):
            out[i, k] = axes[0, k] * u[i, 0] + axes[1, k] * u[i, 1] + axes[2, k] * u[i, 2]
