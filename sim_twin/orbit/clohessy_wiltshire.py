r"""Clohessy-Wiltshire: relative motion, linearised about a circular orbit.

Source: Eq. (11) of W. Gao, K. Li, C. Wei, "Satellite Cluster Formation Reconfiguration Based on the
Bifurcating Potential Field", Aerospace 9:137, 2022, with its axes: x forward along the orbit,
y against the orbit's normal, z to the centre of the Earth.

    x'' = 2 w z' + u_x        y'' = -w^2 y + u_y        z'' = 3 w^2 z - 2 w x' + u_z
"""

import math

import numpy as np
from numpy.typing import NDArray

from testbed.core.compiled import compiled

Array = NDArray[np.float64]


@compiled
def drift_all(w, p, v, out):
    """Write the acceleration without thrust [m/s^2] of n satellites.

    Args:
        w: mean motion of the orbit [rad/s].
        p: positions, shape (n, 3) [m].
        v: velocities, shape (n, 3) [m/s].
        out: shape (n, 3).
    """
    for i in range(p.shape[0]):  # Eq. (11)
        out[i, 0] = 2.0 * w * v[i, 2]
        out[i, 1] = -w * w * p[i, 1]
        out[i, 2] = 3.0 * w * w * p[i, 2] - 2.0 * w * v[i, 0]


def transition(w: float, t: float) -> Array:
    """Matrix (6, 6) that takes (x, y, z, x', y', z') over the time `t` [s], closed form."""
    c, s, turn = math.cos(w * t), math.sin(w * t), w * t
    matrix = np.zeros((6, 6))
    matrix[0, [0, 2, 3, 5]] = 1.0, 6.0 * (turn - s), (4.0 * s - 3.0 * turn) / w, 2.0 * (1.0 - c) / w
    matrix[1, [1, 4]] = c, s / w
    matrix[2, [2, 3, 5]] = 4.0 - 3.0 * c, -2.0 * (1.0 - c) / w, s / w
    matrix[3, [2, 3, 5]] = 6.0 * w * (1.0 - c), 4.0 * c - 3.0, 2.0 * s
    matrix[4, [1, 4]] = -w * s, c
    matrix[5, [2, 3, 5]] = 3.0 * w * s, -2.0 * s, c
    return matrix
