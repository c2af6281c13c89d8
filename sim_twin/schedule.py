"""The body wrench of a whole run: from valve pulses or commanded wrenches to linear pieces.

`flow.pieces` does this for the four newest pulses of a valve; a log has thousands.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.compiled import compiled
from testbed.core.pulse import Timing, corners

Array = NDArray[np.float64]


class Schedule(NamedTuple):
    """Pieces over which the wrench is linear in time; no wrench before the first."""

    start: Array  # (n + 1,) start of each piece and the end of the last [s]
    value: Array  # (n, 4) fx, fy, tau about the body's origin, sum of thrusts, at the start
    slope: Array  # (n, 4)


@compiled
def schedule_of_pulses(up, down, owner, far, delay, timing, effect, thrust, droop, spread):
    """The wrench of `n` pulses commanded on [up, down) [s].

    Args:
        up: opening commands, shape (n,) [s].
        down: closing commands.
        owner: index of each pulse's jet, shape (n,).
        far: how far each opens, 0 to 1, shape (n,).
        delay: of all commands [s].
        timing: open delay, close delay, open ramp, close ramp, shape (4,) [s].
        effect: wrench of each fully open jet, shape (3, jets).
        thrust: its magnitude, shape (jets,) [N].
        droop: k of vehicle.Air.
        spread: `far` is a share of time; the number of open jets is its sum.
    """
    valve = Timing(timing[0], timing[1], timing[2], timing[3])
    count, jets = up.shape[0], thrust.shape[0]
    shape = np.empty((count, 5))
    for k in range(count):
        shape[k] = corners(up[k] + delay, down[k] + delay, valve)
    start = np.unique(shape[:, :4].copy().ravel())
    if start.shape[0] < 2:
        return Schedule(np.array([0.0, 1.0]), np.zeros((1, 4)), np.zeros((1, 4)))
    n = start.shape[0] - 1
    level, rate = np.zeros((n, jets)), np.zeros((n, jets))
    for k in range(count):
        a, b, c, d, peak = shape[k]
        peak *= far[k]
        if peak == 0.0:
            continue
        j = owner[k]
        i = np.searchsorted(start, a)
        while i < n and start[i] < d:
            if start[i] < b:
                grows = peak / (b - a)
                level[i, j] += (start[i] - a) * grows
            elif start[i] < c:
                grows = 0.0
                level[i, j] += peak
            else:
                grows = -peak / (d - c)
                level[i, j] += (start[i] - d) * grows
            rate[i, j] += grows
            i += 1
    value, slope = np.zeros((n, 4)), np.zeros((n, 4))
    for i in range(n):
        width = start[i + 1] - start[i]
        open_jets = 0.0
        for j in range(jets):
            middle = level[i, j] + 0.5 * width * rate[i, j]
            if middle > 1.0:  # pulses that overlap: a valve is at most fully open
                level[i, j], rate[i, j], middle = 1.0, 0.0, 1.0
            if middle > 0.0:
                open_jets += middle if spread else 1.0
        share = 1.0 / (1.0 + droop * (open_jets - 1)) if open_jets > 1 else 1.0
        for j in range(jets):
            for axis in range(3):
                value[i, axis] += share * effect[axis, j] * level[i, j]
                slope[i, axis] += share * effect[axis, j] * rate[i, j]
            value[i, 3] += share * thrust[j] * level[i, j]
            slope[i, 3] += share * thrust[j] * rate[i, j]
    return Schedule(start, value, slope)


@compiled
def schedule_of_wrenches(t, wrench, delay, ramp):
    """Wrenches held from `t`, (n,) [s], to the next; each is reached linearly within `ramp` [s]."""
    n = t.shape[0]
    start, value, slope = np.empty(2 * n), np.zeros((2 * n - 1, 4)), np.zeros((2 * n - 1, 4))
    for k in range(n):
        width = min(ramp, 0.5 * (t[k + 1] - t[k])) if k + 1 < n else ramp
        width = max(width, 1e-6)
        start[2 * k], start[2 * k + 1] = t[k] + delay, t[k] + delay + width
        for axis in range(3):
            before = wrench[k - 1, axis] if k > 0 else 0.0
            value[2 * k, axis] = before
            slope[2 * k, axis] = (wrench[k, axis] - before) / width
            if k + 1 < n:
                value[2 * k + 1, axis] = wrench[k, axis]
    return Schedule(start, value, slope)
