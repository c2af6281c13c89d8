"""One period of a law's reference model in one compiled call, and the setpoint that it gives.

For laws in compiled code that send no messages, with a goal and obstacles that stand still. The
steps and their results are those of `Guidance` for any law, which calls them one by one.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.bundle import Bundle, unpacked
from testbed.core.code_address import CodeAddress, called
from testbed.core.compiled import compiled
from testbed.core.law import Body, Neighbours, World, propagate_of
from testbed.core.rows import SETPOINT_WIDTH, References, States
from testbed.flight.barrier import Limits, guarded
from testbed.flight.record import TRAJECTORY

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

FIRST, WIDTH = SETPOINT_WIDTH, References.width


class ReferenceModel(NamedTuple):
    """A law, its reference model and what it knows of the others."""

    law: Any  # see law.propagate_of
    law_state: Array  # (n,) changed in place
    motion: Array  # position [m] and velocity [m/s] of the model, (2, 2), changed in place
    still: Array  # zeros, (2,)
    mass: float  # [kg]
    max_force: float  # [N]
    vehicle_index: int  # of its vehicle in the formation
    period: float  # [s]
    steps: int  # of the law in a period
    world: World
    others: Neighbours  # positions and velocities are written to
    order: Whole  # rows of the others in the states heard
    guards: bool  # a safety filter is on; it has what follows
    obstacles: Array  # see barrier.guarded
    limits: Limits
    neighbour_limits: Array  # of the vehicles heard, see Barrier.neighbour_limits, (n, 2)
    near: Array  # written to: these as in barrier.around, (n, 7)
    ahead: Array  # references that are not due yet, see rows.References, (m, 10); shifted
    life: float  # of a setpoint after its last reference [s]


@compiled
def extrapolate(states, order, t, p, v):
    """Write to `p` and `v`, (n, 2), where the vehicles `order` in `states` are at `t` [s]."""
    for i in range(order.shape[0]):
        one = states[order[i]]
        ago = t - one[0]
        for axis in range(2):
            v[i, axis] = one[4 + axis]
            p[i, axis] = one[1 + axis] + ago * one[4 + axis]


@compiled
def advance_model(bundle, states, t, turn, row):
    """Advance the model by one period.

    Args:
        bundle: of a ReferenceModel.
        states: newest states of the vehicles heard, see rows.States, (n, 12).
        t: begin of the period [s].
        turn: heading, turn rate and angular acceleration then [rad, rad/s, rad/s^2].
        row: written to: the reference for this time, see rows.References, (10,).

    Returns:
        change of the law's force by the safety filter in W [N], and the hazard that it avoids, see
        barrier.guarded; -1: none.
    """
    it = unpacked(bundle)
    p, v, h = it.motion[0], it.motion[1], it.period
    px, py, vx, vy = p[0], p[1], v[0], v[1]
    extrapolate(states, it.order, t, it.others.p, it.others.v)
    own = Body(p, v, it.mass, it.still, it.still, it.max_force, it.vehicle_index)
    ahead = propagate_of(it.law, it.law_state, own, it.others, it.world, t, h, it.steps)
    it.law_state[:] = ahead.law_state
    p[:], v[:] = ahead.p, ahead.v
    fx, fy = ahead.mean_force[0], ahead.mean_force[1]
    dfx, dfy, hazard = 0.0, 0.0, -1
    if it.guards:
        near = it.near
        for i in range(near.shape[0]):
            one = states[i]
            near[i, 0], near[i, 1], near[i, 2], near[i, 3] = one[1], one[2], one[4], one[5]
            keep, hard = it.neighbour_limits[i]
            near[i, 4], near[i, 5], near[i, 6] = keep, one[0], hard
        x, y, hazard, _ = guarded(
            t, fx, fy, px, py, vx, vy, 0.0, 0.0, it.obstacles, near, it.limits, 1.0
        )
        if hazard >= 0:
            dfx, dfy, fx, fy = x - fx, y - fy, x, y
            ax, ay = fx / it.mass, fy / it.mass
            p[0], p[1] = px + h * (vx + 0.5 * h * ax), py + h * (vy + 0.5 * h * ay)
            v[0], v[1] = vx + h * ax, vy + h * ay
    row[0], row[1], row[2], row[3] = t, px, py, turn[0]
    row[4], row[5], row[6] = vx, vy, turn[1]
    row[7], row[8], row[9] = fx / it.mass, fy / it.mass, turn[2]
    return dfx, dfy, hazard


def code_for(model: Bundle) -> CodeAddress:
    """The machine code of `advance_model` for a model of this kind.

    `next_setpoint` calls it, so that the law is compiled once.
    """
    if (code := _CODES.get(model.kind)) is None:
        states, row = np.empty((0, States.width)), np.empty(WIDTH)
        args = model, states, 0.0, (0.0, 0.0, 0.0), row
        code = _CODES[model.kind] = CodeAddress(advance_model, args)
    return code


_CODES: dict[Any, CodeAddress] = {}  # by kind of the model: it takes half a millisecond to find one


@compiled
def next_setpoint(code, bundle, states, t, turn, row):
    """The setpoint of a law that has sent its references up to `t`: these, and one more.

    Args:
        code: see `code_for`.
        bundle: see `advance_model`, like `states`, `t` and `turn`.
        row: written to: see rows.row_of_setpoint, (8 + 10 (m + 1),).

    Returns:
        see `advance_model`.
    """
    it = unpacked(bundle)
    ahead = it.ahead
    m = ahead.shape[0]
    changed = called(code, (bundle, states, t, turn, row[FIRST + m * WIDTH :]))
    for i in range(m):
        for k in range(WIDTH):
            row[FIRST + i * WIDTH + k] = ahead[i, k]
            ahead[i, k] = row[FIRST + m * WIDTH + k] if i + 1 == m else ahead[i + 1, k]
    row[:FIRST] = 0.0
    row[0], row[1], row[2] = TRAJECTORY, row[FIRST], t + it.life
    return changed
