"""The table's surface: tilt, friction and edges."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.compiled import inlined
from testbed.core.table import Table

Array = NDArray[np.float64]

CREEP = 0.001  # below this speed friction fades, so that the integration stays smooth [m/s]


class Ground(NamedTuple):
    """Parameters of the table for compiled code."""

    half: Array  # (2,) half of the size [m]
    uniform: Array  # (2,) tilt acceleration [m/s^2]
    map: Array  # (rows, columns, 2) added to `uniform`, on a regular grid; empty: none [m/s^2]
    restitution: float
    patches: Array  # (n, 4) x, y, radius [m], deceleration by dry friction [m/s^2]


def lay(table: Table) -> Ground:
    """Convert the table of a table file."""
    grid = np.array(table.tilt.map, dtype=float)
    return Ground(
        np.array(table.size) / 2.0,
        np.array(table.tilt.uniform, dtype=float),
        grid if grid.ndim == 3 else np.zeros((0, 0, 2)),
        table.restitution,
        np.array([(*p.position, p.radius, p.slows) for p in table.friction]).reshape(-1, 4),
    )


@inlined
def tilt_at(ground, x, y):
    """Acceleration along the surface at a point (ax, ay) [m/s^2]."""
    ax, ay = ground.uniform[0], ground.uniform[1]
    rows, columns = ground.map.shape[0], ground.map.shape[1]
    if rows == 0:
        return ax, ay
    u = min(max((x / ground.half[0] + 1.0) * 0.5, 0.0), 1.0) * (columns - 1)
    v = min(max((y / ground.half[1] + 1.0) * 0.5, 0.0), 1.0) * (rows - 1)
    i = min(int(u), max(columns - 2, 0))
    j = min(int(v), max(rows - 2, 0))
    i2, j2 = min(i + 1, columns - 1), min(j + 1, rows - 1)
    p, q = u - i, v - j
    for axis in range(2):
        lower = (1.0 - p) * ground.map[j, i, axis] + p * ground.map[j, i2, axis]
        upper = (1.0 - p) * ground.map[j2, i, axis] + p * ground.map[j2, i2, axis]
        value = (1.0 - q) * lower + q * upper
        if axis == 0:
            ax += value
        else:
            ay += value
    return ax, ay


@inlined
def friction_at(ground, x, y, vx, vy):
    """Deceleration over speed [1/s] of a vehicle that floats over a point."""
    rate = 0.0
    for k in range(ground.patches.shape[0]):
        dx, dy, radius = x - ground.patches[k, 0], y - ground.patches[k, 1], ground.patches[k, 2]
        if dx * dx + dy * dy < radius * radius:
            rate += ground.patches[k, 3] / np.sqrt(vx * vx + vy * vy + CREEP * CREEP)
    return rate
