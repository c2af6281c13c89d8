"""Touches: disc against disc, disc against the table's edge, disc against an obstacle's solid core.

Frictionless impulses with restitution at the instant of first touch. Every touch is recorded: on
granite it would be an accident.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_twin.air import body_now
from testbed.core.compiled import compiled

Array = NDArray[np.float64]

SOFT = 1e-3  # [m/s] slower touches do not bounce
SAME_TOUCH = 0.5  # [s] touches of the same pair within this are one
EDGES = 4


class Solids(NamedTuple):
    """Obstacles that can be hit."""

    p: Array  # (n, 2) at the start of the run [m]
    v: Array  # (n, 2) [m/s]
    radius: Array  # (n,) [m]


@compiled
def candidate(x, parameters, ground, solids, t, i, key):
    """Gap and normal of one possible contact of vehicle `i`.

    `key` counts the other vehicles first, then the right, left, upper and lower edge, then the
    solids.

    Returns:
        (gap [m], normal x, normal y towards vehicle i, normal velocity [m/s], negative: closing).
    """
    vehicles = x.shape[0]
    if key < vehicles:
        ox, oy = x[i, 0] - x[key, 0], x[i, 1] - x[key, 1]
        ux, uy = x[i, 3] - x[key, 3], x[i, 4] - x[key, 4]
        reach = parameters.radius[i] + parameters.radius[key]
    elif key < vehicles + EDGES:
        edge = key - vehicles
        axis, side = edge // 2, 1.0 - 2.0 * (edge % 2)
        gap = ground.half[axis] - parameters.radius[i] - side * x[i, axis]
        speed = -side * x[i, 3 + axis]
        return gap, -side * (1.0 - axis), -side * axis, speed
    else:
        k = key - vehicles - EDGES
        ox = x[i, 0] - solids.p[k, 0] - t * solids.v[k, 0]
        oy = x[i, 1] - solids.p[k, 1] - t * solids.v[k, 1]
        ux, uy = x[i, 3] - solids.v[k, 0], x[i, 4] - solids.v[k, 1]
        reach = parameters.radius[i] + solids.radius[k]
    distance = np.sqrt(ox * ox + oy * oy)
    if distance == 0.0:
        return -reach, 1.0, 0.0, ux
    nx, ny = ox / distance, oy / distance
    return distance - reach, nx, ny, ux * nx + uy * ny


@compiled
def keys(vehicles, solids):
    """How many candidates a vehicle has."""
    return vehicles + EDGES + solids


@compiled
def closing(x, parameters, ground, solids, t):
    """Whether any two bodies overlap and still approach."""
    vehicles = x.shape[0]
    for i in range(vehicles):
        for key in range(keys(vehicles, solids.p.shape[0])):
            if key <= i and key < vehicles:
                continue
            gap, _, _, speed = candidate(x, parameters, ground, solids, t, i, key)
            if gap < 0.0 and speed < 0.0:
                return True
    return False


@compiled
def yielding(x, parameters, used, i, nx, ny):
    """What an impulse along the normal does to vehicle `i`.

    Returns:
        (1/effective mass, 1/mass, arm / inertia, and the centre of mass from the origin in W x, y).
    """
    mass, inertia, cx, cy = body_now(parameters, i, used[i])
    c, s = np.cos(x[i, 2]), np.sin(x[i, 2])
    rx, ry = c * cx - s * cy, s * cx + c * cy
    arm = -rx * ny + ry * nx
    return 1.0 / mass + arm * arm / inertia, 1.0 / mass, arm / inertia, rx, ry


@compiled
def push(x, parameters, used, i, nx, ny, impulse):
    """Apply an impulse [N s] along the normal to vehicle `i`, through its disc's centre."""
    _, per_mass, per_inertia, rx, ry = yielding(x, parameters, used, i, nx, ny)
    spin = impulse * per_inertia
    x[i, 5] += spin
    x[i, 3] += impulse * nx * per_mass + spin * ry
    x[i, 4] += impulse * ny * per_mass - spin * rx


@compiled
def resolve(x, parameters, used, ground, solids, t, last_touch, touches, count):
    """Impulses for everything that overlaps and approaches, and the overlap taken out, in place.

    Args:
        x: states, shape (v, 6).
        parameters: the true vehicles.
        used: gas gone, shape (v,) [kg].
        ground: the table.
        solids: what stands on it.
        t: time of the run [s].
        last_touch: time of the last touch of each candidate, shape (v, keys), written to.
        touches: rows (time, vehicle, key, closing speed), shape (n, 4), written to.
        count: rows already used.

    Returns:
        rows used now.
    """
    vehicles = x.shape[0]
    for i in range(vehicles):
        for key in range(keys(vehicles, solids.p.shape[0])):
            if key <= i and key < vehicles:
                continue
            gap, nx, ny, speed = candidate(x, parameters, ground, solids, t, i, key)
            if gap >= 0.0 or speed >= 0.0:
                continue
            bounce = ground.restitution if speed < -SOFT else 0.0
            soft_i, per_mass_i, _, _, _ = yielding(x, parameters, used, i, nx, ny)
            if key < vehicles:
                soft_k, per_mass_k, _, _, _ = yielding(x, parameters, used, key, nx, ny)
                impulse = -(1.0 + bounce) * speed / (soft_i + soft_k)
                share = per_mass_i / (per_mass_i + per_mass_k)
                push(x, parameters, used, key, nx, ny, -impulse)
                x[key, 0] += (1.0 - share) * gap * nx
                x[key, 1] += (1.0 - share) * gap * ny
            else:
                impulse = -(1.0 + bounce) * speed / soft_i
                share = 1.0
            push(x, parameters, used, i, nx, ny, impulse)
            x[i, 0] -= share * gap * nx
            x[i, 1] -= share * gap * ny
            if t - last_touch[i, key] > SAME_TOUCH and count < touches.shape[0]:
                touches[count] = t, float(i), float(key), -speed
                count += 1
            last_touch[i, key] = t
    return count
