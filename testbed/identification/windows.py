"""Short windows of a log, each flown by the model from a state of its own."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_twin.prediction import shoot
from testbed.identification.model import VehicleModel
from testbed.identification.motion_log import PAUSE, MotionLog
from testbed.identification.prediction import Wrenches, used_before

Array = NDArray[np.float64]
NUDGE = {2: 1e-2, 5: 1e-2}  # differences of the initial heading [rad] and rate [rad/s]
FEWEST = 5  # poses in a window


class Windows(NamedTuple):
    """Short pieces of one log that are predicted separately."""

    log: MotionLog
    begin: Array  # (w,) [s]
    marks: Array  # (w, m) times of the poses; NaN: none [s]
    seen: Array  # (w, m, 3) measured poses
    rows: list[NDArray[np.int64]]  # of the log


def stretches(log: MotionLog) -> list[NDArray[np.int64]]:
    """Rows of undisturbed flight without a gap."""
    rows = np.flatnonzero(log.whole)
    if len(rows) < 2:
        return []
    usual = float(np.median(np.diff(log.t)))
    return np.split(rows, np.flatnonzero(np.diff(log.t[rows]) > PAUSE * usual) + 1)


def tiled(log: MotionLog, length: float) -> Windows:
    """Windows side by side that cover all undisturbed flight, each about `length` [s]."""
    found = []
    for rows in stretches(log):
        span = log.t[rows[-1]] - log.t[rows[0]]
        parts = max(1, int(span / length))
        if span < 0.5 * length:
            continue
        edges = log.t[rows[0]] + span * np.arange(parts + 1) / parts
        found += [
            rows[(log.t[rows] >= a - 1e-9) & (log.t[rows] <= b + 1e-9)] for a, b in pairwise(edges)
        ]
    return packed(log, found)


def sliding(log: MotionLog, before: float, ahead: float, every: float) -> Windows:
    """Windows of `before` and `ahead` seconds around instants `every` seconds apart [s]."""
    found = []
    for rows in stretches(log):
        first, last = log.t[rows[0]], log.t[rows[-1]]
        count = int((last - first - before - ahead + 1e-6) / every) + 1
        for a in first + every * np.arange(max(0, count)):
            inside = (log.t[rows] >= a - 1e-6) & (log.t[rows] <= a + before + ahead + 1e-6)
            found.append(rows[inside])
    return packed(log, found)


def packed(log: MotionLog, found: list[NDArray[np.int64]]) -> Windows:
    """Windows from rows of the log; those with few poses are left out."""
    kept = [rows for rows in found if len(rows) >= FEWEST]
    most = max(map(len, kept), default=0)
    marks, seen = np.full((len(kept), most), np.nan), np.full((len(kept), most, 3), np.nan)
    for k, rows in enumerate(kept):
        marks[k, : len(rows)], seen[k, : len(rows)] = log.t[rows], log.pose[rows]
    return Windows(log, marks[:, 0].copy() if kept else np.zeros(0), marks, seen, kept)


def first_guess(windows: Windows, known: NDArray[np.bool_]) -> Array:
    """Initial states from parabolas through the known poses, (w, 6)."""
    x0 = np.zeros((len(windows.begin), 6))
    for k, use in enumerate(known):
        t = windows.marks[k, use] - windows.begin[k]
        fit = np.polynomial.polynomial.polyfit(t, windows.seen[k, use], min(2, len(t) - 1))
        x0[k, :3], x0[k, 3:] = fit[0], fit[1]
    return x0


def fly(
    model: VehicleModel, p: Array, windows: Windows, x0: Array, effect: Array | None = None
) -> Array:
    """Poses at the marks, (w, m, 3)."""
    inputs = windows.log.inputs
    in_table = isinstance(inputs, Wrenches) and inputs.in_table
    plant = model.build(p, inputs, effect)
    used = used_before(*plant[:2], windows.begin)
    return shoot(x0, used, windows.begin, windows.marks, *plant, in_table)[..., :3]


def fly_with_slopes(
    model: VehicleModel, p: Array, windows: Windows, x0: Array
) -> tuple[Array, Array]:
    """Poses at the marks, and their derivatives by the initial state, (w, m, 3, 6).

    Those by position and velocity are 1 and the time: exact without drag and map, and close enough
    with them.
    """
    flown = fly(model, p, windows, x0)
    by_state = np.zeros((*flown.shape, 6))
    after = windows.marks - windows.begin[:, None]
    for axis in (0, 1):
        by_state[..., axis, axis] = 1.0
        by_state[..., axis, 3 + axis] = after
    for k, nudge in NUDGE.items():
        moved = x0.copy()
        moved[:, k] += nudge
        by_state[..., k] = (fly(model, p, windows, moved) - flown) / nudge
    return flown, by_state


def ahead_of(
    model: VehicleModel, p: Array, windows: Windows, before: float, weight: Array, passes: int = 3
) -> Array:
    """Errors of the flown poses, (w, m, 3); states are fitted to the first `before` seconds only.

    Args:
        model: the vehicle.
        p: its numbers.
        windows: from `sliding`.
        before: [s].
        weight: of x, y and theta in the fit of the states, shape (3,).
        passes: of the fit.
    """
    known = windows.marks <= windows.begin[:, None] + before + 1e-6
    x0 = first_guess(windows, known)
    for _ in range(passes):
        flown, by_state = fly_with_slopes(model, p, windows, x0)
        for k, use in enumerate(known):
            lhs = (by_state[k, use] * weight[:, None]).reshape(-1, 6)
            rhs = ((windows.seen[k, use] - flown[k, use]) * weight).ravel()
            x0[k] += np.linalg.lstsq(lhs, rhs, rcond=None)[0]
    return windows.seen - fly(model, p, windows, x0)
