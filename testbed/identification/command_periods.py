"""When in a log each period of the valve commands starts.

A command is taken once per period. The log has more rows than periods, and its clock may start at
any time; so the rows in which a command changes tell the phase of the periods. They lie within one
row after it. The earliest of them is taken as the start of its period: a command may have been
given up to one row before.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
WHOLE = 0.75  # rows further apart than this many periods are a period each
FEWEST = 5  # changes that tell a phase
MOST = 0.95  # share of the changes that must lie within a row of each other
ROW = 0.98  # of the time between two rows: changes of one phase lie closer together
EARLY = 1e-3  # of a period: rounding of the times
NOTE = (
    "the changes of the valve commands do not tell when in the log's time a period starts: it is"
    " taken at whole multiples of period_s, and the delay may be wrong by up to a period; give"
    " phase_s in [valves] of the mapping, or the right period_s"
)


def periods(
    t: Array, share: Array, period: float, phase: float | None
) -> tuple[Array, NDArray[np.bool_], list[str]]:
    """Starts of the periods, the row in which each command is read, and notes.

    Args:
        t: times of the rows, shape (n,) [s].
        share: commands, shape (n, jets).
        period: [s].
        phase: a start of a period, where it is known [s]; None: the changes tell it.

    Returns:
        times of the commands, shape (m,) [s]; which rows have them, shape (n,), m are True; notes.
    """
    step = float(np.median(np.diff(t)))
    if step > WHOLE * period:
        return t, np.ones(len(t), dtype=bool), []
    on_grid, notes = True, []
    if phase is None:
        phase, part = phase_of(t, share, period, step)
        if part < MOST:
            phase, on_grid, notes = 0.0, False, [NOTE]
    turn = np.floor((t - phase) / period + EARLY)
    taken = np.append(True, np.diff(turn) > 0)
    start = t[taken]
    if on_grid:  # the first row of a period comes up to a row late
        grid = phase + period * turn[taken]
        start = np.where(np.abs(start - grid) <= 1.05 * step, grid, start)
    return start, taken, notes


def phase_of(t: Array, share: Array, period: float, step: float) -> tuple[float, float]:
    """A start of a period, by the earliest changes [s], and the share of the changes that agree.

    The share is 0 where commands hardly change.
    """
    changed = np.flatnonzero((np.diff(share, axis=0) != 0.0).any(axis=1)) + 1
    changed = changed[t[changed] - t[changed - 1] < 1.5 * step]  # no gap before
    if len(changed) < FEWEST:
        return 0.0, 0.0
    late = np.sort((t[changed] - t[changed[0]]) % period)
    ahead = np.append(late, late + period)
    within = np.searchsorted(ahead, late + ROW * step, side="right") - np.arange(len(late))
    best = int(np.argmax(within))
    return float(t[changed[0]] + late[best]), float(within[best] / len(late))
