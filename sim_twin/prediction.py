"""Motion of one vehicle ahead of given states: many short flights at once, without noise.

The physics are the plant's: `air.breathe` and `body.step` over pieces of linear wrench.
"""

import numpy as np

from sim_twin.air import breathe
from sim_twin.body import new_stages, step
from testbed.core.compiled import borrowed, compiled, keep

FLAT_STEP = 0.1  # [s] longest step on a table without a map
MAP_STEP = 0.02  # [s] on a map, or with forces in W


@compiled
def shoot(x0, used0, begin, marks, schedule, parameters, ground, in_table):
    """States at the marks of several windows, each from its own initial state.

    Args:
        x0: initial states, shape (w, 6), see body.py.
        used0: gas consumed before each, shape (w,) [kg].
        begin: time of each, shape (w,) [s].
        marks: increasing times at which to record the state, shape (w, m); NaN: none [s].
        schedule: the body wrench.
        parameters: of one vehicle.
        ground: the table.
        in_table: the forces of the schedule are in W; they are turned into B at the middle of a
            step.

    Returns:
        states, shape (w, m, 6); NaN where there is no mark.
    """
    parameters, ground, schedule = borrowed(parameters), borrowed(ground), borrowed(schedule)
    start, value, slope = schedule
    pieces = value.shape[0]
    own = new_stages()
    stages = borrowed(own)
    longest = MAP_STEP if in_table or ground.map.shape[0] > 0 else FLAT_STEP
    seen = np.full((marks.shape[0], marks.shape[1], 6), np.nan)
    now, rate = np.zeros(4), np.zeros(4)
    for w in range(x0.shape[0]):
        x, t, used = x0[w].copy(), begin[w], used0[w]
        i = np.searchsorted(start, t, side="right") - 1
        for m in range(marks.shape[1]):
            if np.isnan(marks[w, m]):
                continue
            while t < marks[w, m]:
                end = min(marks[w, m], t + longest)
                if i + 1 <= pieces:
                    if start[i + 1] <= t:
                        i += 1
                        continue
                    end = min(end, start[i + 1])
                now[:], rate[:] = 0.0, 0.0
                if 0 <= i < pieces:
                    rate[:] = slope[i]
                    now[:] = value[i] + slope[i] * (t - start[i])
                if in_table:
                    angle = x[2] + 0.5 * (end - t) * x[5]
                    c, s = np.cos(angle), np.sin(angle)
                    now[0], now[1] = c * now[0] + s * now[1], c * now[1] - s * now[0]
                    rate[0], rate[1] = c * rate[0] + s * rate[1], c * rate[1] - s * rate[0]
                used, _ = breathe(stages, now, rate, 0.0, end - t, parameters, 0, used)
                drag, spin_drag = parameters.drag[0], parameters.spin_drag[0]
                step(x, end - t, stages, drag, spin_drag, parameters.hose[0], ground)
                t = end
            seen[w, m] = x
    keep(own)
    return seen
