"""A way out of the path of moving obstacles.

A vehicle that can stop is safe from what stands, but an obstacle that moves reaches it later. So
with a moving obstacle on the table one more condition holds for every force: after the coming
period at least one short flight must exist that comes to rest, and that keeps clear of everything
for `LOOK` seconds. Tried are a stop, a few places around it and a grid over the table. If no flight
is left, the vehicle flies the first period of the flight that keeps most clearance, from where it
is. The next period repeats this from the new state, so nothing needs to be remembered. The flights
use the planned acceleration. What the jets can do beyond it is the reserve: with it a second search
looks for a way out where the first has found none.

Neighbours go on for `HEARD` seconds and then stand. A neighbour that a moving obstacle reaches
earlier has the right of way: the others make room around it.

See S. Petti, T. Fraichard, "Safe motion planning in dynamic environments", IROS, 2005, for states
from which no way out is left, and T. Gurriet et al., "A scalable safety critical control framework
for nonlinear systems", IEEE Access 8, 2020, for filters that keep a backup flight possible.
"""

import numpy as np

from testbed.core.compiled import compiled

LOOK = 30.0  # [s] of a flight tried
STEP = 0.4  # between two of its instants [s]
CRUISE = 0.18  # its speed [m/s]
EASE = 0.6  # share of the planned deceleration with which it comes to rest
RESERVE = 0.9  # share of the whole force of the jets for a flight that must not be late
AROUND, NEAR = 8, 0.4  # places around the stop, and their distance from it [m]
GRID = 6  # places over the table, per side
CLEAR = 0.02  # kept from a moving obstacle, beyond its margin [m]
ALLOWED = 0.01  # into the margins of what stands, where the half-planes hold a vehicle [m]
YIELDED = 0.005  # the same for vehicles [m]
GOOD = 0.02  # clearance with which the search ends [m]
HEARD = 1.0  # a neighbour keeps its velocity for this long [s]
# A vehicle that is reached within this time may have the right of way; too_near does not stop it.
URGENT = 12.0  # [s]
NARROW = 0.1  # a miss by less than this counts as reached [m]
GIVE_WAY = 0.3  # distance made for it [m]
# Time to make it [s]: until the neighbour is reached. A fixed time would begin anew each period.
WITHIN = (1.5, 5.0)


@compiled
def toward(px, py, vx, vy, gx, gy, accel):
    """Change of velocity within `STEP` of a flight that comes to rest at (gx, gy) [m/s]."""
    dx, dy = gx - px, gy - py
    far = np.sqrt(dx * dx + dy * dy)
    ux, uy = -vx, -vy
    if far > 1e-9:
        speed = min(CRUISE, np.sqrt(2.0 * EASE * accel * far), far / STEP)
        ux += speed * dx / far
        uy += speed * dy / far
    size, most = np.sqrt(ux * ux + uy * uy), accel * STEP
    return (ux * most / size, uy * most / size) if size > most else (ux, uy)


@compiled
def clearance(px, py, vx, vy, gx, gy, discs, wide, limits, accel, least):
    """Smallest clearance of a flight to (gx, gy) [m]; given up when it is below `least`."""
    worst = np.inf
    for k in range(int(LOOK / STEP)):
        ux, uy = toward(px, py, vx, vy, gx, gy, accel)
        px += STEP * (vx + 0.5 * ux)
        py += STEP * (vy + 0.5 * uy)
        vx += ux
        vy += uy
        t = (k + 1) * STEP
        for i in range(discs.shape[0]):
            on = t if discs[i, 5] == 1.0 else min(t, HEARD)
            rx, ry = px - discs[i, 0] - on * discs[i, 2], py - discs[i, 1] - on * discs[i, 3]
            room = np.sqrt(rx * rx + ry * ry) - discs[i, 4]
            if discs[i, 5] < 1.0:
                room += YIELDED - wide[i, 0] * min(1.0, t / wide[i, 1])
            elif discs[i, 2] != 0.0 or discs[i, 3] != 0.0:
                room -= CLEAR
            else:
                room += ALLOWED
            worst = min(worst, room)
        edge = min(limits.half_x - abs(px), limits.half_y - abs(py))
        worst = min(worst, edge + ALLOWED)
        if worst < least:
            break
    return worst


@compiled
def way_out(px, py, vx, vy, discs, wide, limits, accel, enough):
    """The flight with `enough` clearance, or with most: clearance [m], and where it ends."""
    most, x, y = -np.inf, px, py
    stop = np.sqrt(vx * vx + vy * vy) / (2.0 * EASE * accel)
    sx, sy = px + stop * vx, py + stop * vy
    for k in range(1 + AROUND + GRID * GRID):
        if k == 0:
            gx, gy = sx, sy
        elif k <= AROUND:
            angle = 2.0 * np.pi * k / AROUND
            gx, gy = sx + NEAR * np.cos(angle), sy + NEAR * np.sin(angle)
            if abs(gx) > limits.half_x or abs(gy) > limits.half_y:
                continue
        else:
            row, column = divmod(k - 1 - AROUND, GRID)
            gx = limits.half_x * (2.0 * row / (GRID - 1) - 1.0)
            gy = limits.half_y * (2.0 * column / (GRID - 1) - 1.0)
        room = clearance(px, py, vx, vy, gx, gy, discs, wide, limits, accel, max(most, -1.0))
        if room > most:
            most, x, y = room, gx, gy
        if most >= enough:
            break
    return most, x, y


@compiled
def reached_in(px, py, discs):
    """Time until a moving obstacle reaches a vehicle that stands at (px, py) [s], and which."""
    first, which = np.inf, -1
    for i in range(discs.shape[0]):
        wx, wy = discs[i, 2], discs[i, 3]
        square = wx * wx + wy * wy
        if discs[i, 5] < 1.0 or square == 0.0:
            continue
        rx, ry, reach = px - discs[i, 0], py - discs[i, 1], discs[i, 4] + NARROW
        nearest = (rx * wx + ry * wy) / square  # when it is nearest
        spare = reach * reach - (rx * rx + ry * ry - nearest * nearest * square)
        if spare > 0.0 and nearest > 0.0 and nearest - np.sqrt(spare / square) < first:
            first, which = nearest - np.sqrt(spare / square), i
    return first, which


@compiled
def right_of_way(px, py, discs):
    """For each neighbour that is reached before the vehicle at (px, py): room to make for it.

    Rows of distance [m] and time to do so [s].
    """
    own, _ = reached_in(px, py, discs)
    wide = np.zeros((discs.shape[0], 2))
    for k in range(discs.shape[0]):
        wide[k, 1] = WITHIN[1]
        if discs[k, 5] == 1.0:
            continue
        its, _ = reached_in(discs[k, 0], discs[k, 1], discs)
        if its < min(URGENT, own):
            wide[k, 0], wide[k, 1] = GIVE_WAY, min(max(its, WITHIN[0]), WITHIN[1])
    return wide


@compiled
def escape(fx, fy, px, py, vx, vy, bx, by, discs, limits, thrust_scale):
    """The force that leads out of the path of moving obstacles, if (fx, fy) leaves no way out.

    The arguments are those of `barrier.filtered`, but the force is the filtered one.

    Returns:
        force [N], the number of the moving obstacle (-1: (fx, fy) leaves a way out), and the
        smallest clearance of the flight that begins with this force [m].
    """
    runner = -1
    for k in range(discs.shape[0]):
        if discs[k, 5] == 1.0 and (discs[k, 2] != 0.0 or discs[k, 3] != 0.0):
            runner = k
    if runner < 0:
        return fx, fy, -1, np.inf
    accel, late, h = limits.decel * thrust_scale, limits.slow, limits.period
    wide, soon = right_of_way(px, py, discs), discs.copy()
    soon[:, :2] += late * discs[:, 2:4]
    ax, ay = fx / limits.mass + bx, fy / limits.mass + by
    room, _, _ = way_out(
        px + late * vx + h * (late - 0.5 * h) * ax, py + late * vy + h * (late - 0.5 * h) * ay,
        vx + h * ax, vy + h * ay, soon, wide, limits, accel, 0.0,
    )  # fmt: skip
    if room >= 0.0:
        return fx, fy, -1, room
    room, gx, gy = way_out(px, py, vx, vy, discs, wide, limits, accel, GOOD)
    if room < 0.0:
        hard = RESERVE * limits.hard * thrust_scale
        more, hx, hy = way_out(px, py, vx, vy, discs, wide, limits, hard, GOOD)
        if more > room:
            room, gx, gy, accel = more, hx, hy, hard
    ux, uy = toward(px, py, vx, vy, gx, gy, accel)
    _, reached_by = reached_in(px, py, discs)
    if reached_by >= 0:
        runner = reached_by
    return limits.mass * (ux / STEP - bx), limits.mass * (uy / STEP - by), runner, room
