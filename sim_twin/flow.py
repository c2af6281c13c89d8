"""Converts valve pulses to body wrenches, which are piecewise linear in time."""

import numpy as np

from sim_twin.board import SLOTS
from testbed.core.compiled import compiled
from testbed.core.pulse import Timing, corners


@compiled
def pieces(pulses, timing, effect, thrust, droop, late, origin, span):
    """Cut [0, span] where any jet's flow has a corner.

    Args:
        pulses: board.Pulses of one vehicle.
        timing: open delay, close delay, open ramp, close ramp, shape (4,) [s].
        effect: wrench of each fully open jet, shape (3, jets).
        thrust: its magnitude, shape (jets,) [N].
        droop: k of vehicle.Air.
        late: further delay of each jet's valve, shape (jets,) [s].
        origin: time of the run at which the window starts [ns].
        span: length of the window [s].

    Returns:
        start of each piece and the end of the last [s], shape (n + 1,); fx, fy, tau and the sum of
        the thrust magnitudes at the start of each piece, shape (n, 4); their slopes, shape (n, 4).
    """
    valve = Timing(timing[0], timing[1], timing[2], timing[3])
    jets = pulses.up.shape[0]
    shape = np.empty((jets * SLOTS, 5))  # corners and peak of each pulse in the window
    owner = np.empty(jets * SLOTS, dtype=np.int64)
    strength = np.empty(jets * SLOTS)
    cuts = np.empty(4 * jets * SLOTS + 2)
    cuts[0], cuts[1] = 0.0, span
    active, cut_count = 0, 2
    for j in range(jets):
        for k in range(SLOTS):
            if pulses.down[j, k] <= pulses.up[j, k]:
                continue
            a, b, c, d, peak = corners(
                (pulses.up[j, k] - origin) * 1e-9 + late[j],
                (pulses.down[j, k] - origin) * 1e-9 + late[j],
                valve,
            )
            if peak == 0.0 or d <= 0.0 or a >= span:
                continue
            shape[active] = a, b, c, d, peak
            owner[active] = j
            strength[active] = pulses.strength[j, k]
            active += 1
            for corner in (a, b, c, d):
                if 0.0 < corner < span:
                    cuts[cut_count] = corner
                    cut_count += 1
    ordered = np.sort(cuts[:cut_count])
    start = np.empty(cut_count)
    start[0] = 0.0
    n = 0
    for k in range(1, cut_count):
        if ordered[k] > start[n]:
            n += 1
            start[n] = ordered[k]
    value, slope = np.zeros((n, 4)), np.zeros((n, 4))
    for i in range(n):
        middle = 0.5 * (start[i] + start[i + 1])
        open_jets, last = 0, -1  # pulses of one jet stand next to each other
        for m in range(active):
            a, b, c, d, peak = shape[m]
            if middle <= a or middle >= d:
                continue
            if middle < b:
                rate = peak / (b - a)
                level = (start[i] - a) * rate
            elif middle <= c:
                rate, level = 0.0, peak
            else:
                rate = -peak / (d - c)
                level = (start[i] - d) * rate
            j = owner[m]
            if j != last:
                open_jets += 1
                last = j
            level *= strength[m]
            rate *= strength[m]
            for axis in range(3):
                value[i, axis] += effect[axis, j] * level
                slope[i, axis] += effect[axis, j] * rate
            value[i, 3] += thrust[j] * level
            slope[i, 3] += thrust[j] * rate
        if open_jets > 1:
            share = 1.0 / (1.0 + droop * (open_jets - 1))
            value[i] *= share
            slope[i] *= share
    return start[: n + 1], value, slope
