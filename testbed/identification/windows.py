"""Short windows of a log, each flown by the model from a state of its own."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_twin.ground import Ground
from sim_twin.plant_parameters import PlantParameters
from sim_twin.prediction import shoot
from sim_twin.schedule import Schedule
from testbed.identification.model import VehicleModel
from testbed.identification.motion_log import PAUSE, MotionLog
from testbed.identification.prediction import Wrenches, used_before

Array = NDArray[np.float64]
NUDGE = {2: 1e-2, 5: 1e-2}  # differences of the initial heading [rad] and rate [rad/s]
FEWEST = 5  # poses in a window
ALL = slice(None)


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
        t = log.t[rows]
        span = t[-1] - t[0]
        parts = max(1, int(span / length))
        if span < 0.5 * length:
            continue
        edges = t[0] + span * np.arange(parts + 1) / parts
        found += [_between(rows, t, a - 1e-9, b + 1e-9) for a, b in pairwise(edges)]
    return packed(log, found)


def sliding(log: MotionLog, before: float, ahead: float, every: float) -> Windows:
    """Windows of `before` and `ahead` seconds around instants `every` seconds apart [s]."""
    found = []
    for rows in stretches(log):
        t = log.t[rows]
        count = int((t[-1] - t[0] - before - ahead + 1e-6) / every) + 1
        for a in t[0] + every * np.arange(max(0, count)):
            found.append(_between(rows, t, a - 1e-6, a + before + ahead + 1e-6))
    return packed(log, found)


def _between(rows: NDArray[np.int64], t: Array, begin: float, end: float) -> NDArray[np.int64]:
    """Those of some rows, with increasing times `t`, that lie from `begin` to `end` [s]."""
    return rows[np.searchsorted(t, begin) : np.searchsorted(t, end, side="right")]


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


class Pushed(NamedTuple):
    """A vehicle, and how it is pushed in a log: arguments of `shoot`."""

    used: Array  # (w,) gas consumed before each window [kg]
    schedule: Schedule
    plant: PlantParameters
    ground: Ground
    in_table: bool

    def fly(self, windows: Windows, x0: Array, part: slice = ALL) -> Array:
        """Poses at the marks of some windows, (w, m, 3); NaN where there is no mark."""
        states = shoot(
            x0[part], self.used[part], windows.begin[part], windows.marks[part], *self[1:]
        )
        poses: Array = states[..., :3]
        return poses


def pushed(model: VehicleModel, p: Array, windows: Windows, effect: Array | None = None) -> Pushed:
    """The vehicle with these numbers in a log; `effect` replaces the jets' wrenches."""
    inputs = windows.log.inputs
    in_table = isinstance(inputs, Wrenches) and inputs.in_table
    schedule, plant, ground = model.build(p, inputs, effect)
    used = used_before(schedule, plant, windows.begin)
    return Pushed(used, schedule, plant, ground, in_table)


def flown_with_slopes(
    vehicle: Pushed, windows: Windows, x0: Array, part: slice = ALL
) -> tuple[Array, Array]:
    """Poses at the marks, and their derivatives by the initial state, (w, m, 3, 6).

    Those by position and velocity are 1 and the time: exact without drag and map, and close enough
    with them.
    """
    flown = vehicle.fly(windows, x0, part)
    by_state = np.zeros((*flown.shape, 6))
    after = (windows.marks - windows.begin[:, None])[part]
    for axis in (0, 1):
        by_state[..., axis, axis] = 1.0
        by_state[..., axis, 3 + axis] = after
    for k, nudge in NUDGE.items():
        moved = x0.copy()
        moved[:, k] += nudge
        by_state[..., k] = (vehicle.fly(windows, moved, part) - flown) / nudge
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
    vehicle = pushed(model, p, windows)
    for _ in range(passes):
        flown, by_state = flown_with_slopes(vehicle, windows, x0)
        for k, use in enumerate(known):
            lhs = (by_state[k, use] * weight[:, None]).reshape(-1, 6)
            rhs = ((windows.seen[k, use] - flown[k, use]) * weight).ravel()
            x0[k] += np.linalg.lstsq(lhs, rhs, rcond=None)[0]
    return windows.seen - vehicle.fly(windows, x0)
