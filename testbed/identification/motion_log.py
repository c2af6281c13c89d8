"""A log of one vehicle's motion: measured poses and commanded inputs, in SI units."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.vehicle import Vehicle
from testbed.identification.columns import LogRefusedError, NumericColumns, digest, read_columns
from testbed.identification.command_periods import periods
from testbed.identification.frame_queue import frame_times
from testbed.identification.mapping import METRES, RADIANS, SECONDS, Mapping
from testbed.identification.prediction import Inputs, Wrenches, pulses, shares

Array = NDArray[np.float64]
PAUSE = 4.5  # a gap in the rows is longer than this many usual intervals
FEWEST_POSES = 10
FASTEST_HZ = 100.0  # of the poses that are fitted; twice as many are averaged
UPRIGHT = 0.94  # cosine of a body's tilt: 20 deg


class MotionLog(NamedTuple):
    """Poses, where they are measured in undisturbed flight, and the inputs of the whole log."""

    where: str  # file
    digest: str  # SHA-256 of the file
    t: Array  # (n,) of the poses, increasing [s]
    pose: Array  # (n, 3) x, y, theta, continuous [m, m, rad]
    whole: NDArray[np.bool_]  # (n,) undisturbed flight
    inputs: Inputs
    notes: list[str]  # what was left out, and why
    vehicle: Vehicle | None = None  # as it was flown, where the log says it
    window_s: float = 2.5  # length of the windows of a fit [s]


def read_motion_log(path: Path, mapping: Mapping) -> MotionLog:
    """Read a log.

    Raises:
        LogRefusedError: a column is missing, or a value is not what the mapping says.
    """
    own = mapping.pose
    names = [mapping.time.column, own.x, own.y, *(own.quaternion or [own.theta or ""])]
    names += [mapping.pose.new] if mapping.pose.new else []
    if mapping.valves:
        names += mapping.valves.columns
    if mapping.wrench:
        names += [n for n in (mapping.wrench.fx, mapping.wrench.fy, mapping.wrench.tau) if n]
    columns = read_columns(path, [*names, *mapping.use], mapping.rows, mapping.topic)
    for name in [*names, *mapping.use]:
        columns[name]  # refuses a missing one
    t = columns.whole(mapping.time.column) * SECONDS[mapping.time.unit]
    check_clock(t, str(path), mapping)
    pose, measured, lost = _poses(columns, mapping)
    inputs, unsure = _inputs(columns, mapping, t)
    usable = np.ones(len(t), dtype=bool)
    for name, values in mapping.use.items():
        usable &= np.isin(columns[name], values)
    kept = measured & usable
    notes = gaps(t) + lost + unsure
    if kept.sum() < FEWEST_POSES:
        raise LogRefusedError(
            where=str(path),
            expected=f"at least {FEWEST_POSES} measured poses in undisturbed flight",
            found=f"{kept.sum()} of {len(t)} rows",
            hint=f"the mapping keeps rows with {mapping.use}" if mapping.use else "",
        )  # fmt: skip
    rows = np.flatnonzero(measured)
    made, queue = t - mapping.pose.latency_s, mapping.pose.queue
    if queue and np.isfinite(pose).all():
        made = frame_times(made, pose[:, :2], queue.frame_s, queue.frames)
    seen = thinned(made[rows], pose[rows], kept[rows], notes)
    return MotionLog(str(path), digest(path), *seen, inputs, notes)


def thinned(
    t: Array, pose: Array, whole: NDArray[np.bool_], notes: list[str]
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Means of poses that follow each other, where there are more than a fit can use; noted."""
    usual = float(np.median(np.diff(t)))
    together = int(1.0 / (FASTEST_HZ * usual) + 1e-6)
    if together < 2:
        return t, pose, whole
    notes.append(f"{together} poses each, {1.0 / usual:.4g} Hz, are taken as one, their mean")
    count = len(t) // together
    shape = (count, together)
    times, use = t[: count * together].reshape(shape), whole[: count * together].reshape(shape)
    near = np.ptp(times, axis=1) < PAUSE * together * usual
    means = pose[: count * together].reshape((*shape, 3)).mean(axis=1)
    return times.mean(axis=1), means, use.all(axis=1) & near


def check_clock(t: Array, where: str, mapping: Mapping) -> None:
    """Refuse times that go back, stand still or are in another unit."""
    if len(t) < 20:
        raise LogRefusedError(where=where, expected="at least 20 rows", found=f"{len(t)}")
    step = np.diff(t)
    if np.any(step <= 0.0):
        k = int(np.argmax(step <= 0.0))
        hint = "a clock jump, two logs, or two vehicles: [rows] of the mapping chooses one"
        if step[k] == 0.0:
            hint += "; or times that were rounded: write more digits"
        raise LogRefusedError(
            where=f"{where}, data row {k + 2}", expected="a time after the row before",
            found=f"{t[k]:.15g} s, then {t[k + 1]:.15g} s", hint=hint,
        )  # fmt: skip
    usual = float(np.median(step))
    period = mapping.valves.period_s if mapping.valves else None
    low, high = (0.2e-3, 2.0) if period is None else (3e-3 * period, 2.5 * period)
    if not low <= usual <= high:
        raise LogRefusedError(
            where=f"{where}, column {mapping.time.column!r}",
            expected=f"rows {low:.3g} to {high:.3g} s apart", found=f"{usual:.4g} s",
            hint=f"is the unit of time {mapping.time.unit!r}? 1000 times off means ms or us; the"
            " number of a frame is no time",
        )  # fmt: skip


def gaps(t: Array) -> list[str]:
    """Notes about missing rows, or jumps of the clock; no prediction crosses them."""
    step = np.diff(t)
    usual = float(np.median(step))
    found = np.flatnonzero(step > PAUSE * usual)
    notes = [
        f"gap: {step[k]:.3g} s without rows after t = {round(t[k], 3):.15g} s"
        " (or the clock jumped); nothing is fitted across it"
        for k in found[:5]
    ]
    if len(found) > 5:
        notes.append(f"gap: {len(found) - 5} more gaps")
    return notes


def _poses(columns: NumericColumns, mapping: Mapping) -> tuple[Array, NDArray[np.bool_], list[str]]:
    """Poses, which of them are measurements, and notes."""
    own = mapping.pose
    x, y = columns[own.x], columns[own.y]
    if own.quaternion:
        theta = _heading(columns, own.quaternion)
    else:
        theta = columns[own.theta or ""] * RADIANS[own.angle_unit]
    pose = np.stack([x * METRES[own.unit], y * METRES[own.unit], theta], 1)
    nowhere, notes = (pose == 0.0).all(axis=1), []  # as some cameras write a body that they lost
    if nowhere.any():
        notes = [f"lost body: {nowhere.sum()} rows have the pose 0, 0, 0 and are left out"]
    measured: NDArray[np.bool_] = np.asarray(np.isfinite(pose).all(axis=1) & ~nowhere)
    if own.new:
        measured &= columns[own.new] == 1.0
    if not own.new:  # a pose repeated to the last digit is an old one
        again = np.zeros(len(pose), dtype=bool)
        again[1:] = (pose[1:] == pose[:-1]).all(axis=1)
        if again.mean() < 0.9:
            measured &= ~again
    pose[:, 0] -= own.middle[0]
    pose[:, 1] -= own.middle[1]
    rows = np.flatnonzero(measured)
    pose[rows, 2] = np.unwrap(pose[rows, 2])
    return pose, measured, notes


def _heading(columns: NumericColumns, names: tuple[str, ...]) -> Array:
    """Heading about z of unit quaternions; NaN where all four are 0 or one is no number [rad]."""
    four = np.stack([columns[name] for name in names])
    lost = ~np.isfinite(four).all(axis=0) | (four == 0.0).all(axis=0)  # of the body
    x, y, z, w = np.where(lost, np.nan, four)
    off = np.nanmax(np.abs(x * x + y * y + z * z + w * w - 1.0), initial=0.0)
    if off > 0.05:
        raise LogRefusedError(
            where=f"{columns.where}, columns {', '.join(names)}", expected="unit quaternions",
            found=f"a length off by {off:.2g}", hint="the order is x, y, z, w",
        )  # fmt: skip
    upright = np.nanmedian(1.0 - 2.0 * (x * x + y * y)) if np.isfinite(w).any() else 1.0
    if upright < UPRIGHT:
        raise LogRefusedError(
            where=f"{columns.where}, columns {', '.join(names)}",
            expected="a body that lies flat and turns about z",
            found=f"a body tilted by {np.degrees(np.arccos(max(-1.0, upright))):.0f} deg",
            hint="the order is x, y, z, w; of a frame with y up name z, x, y, w, and z and x for"
            " the position",
        )  # fmt: skip
    return np.asarray(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))


def _inputs(columns: NumericColumns, mapping: Mapping, t: Array) -> tuple[Inputs, list[str]]:
    if mapping.wrench:
        own = mapping.wrench
        tau = columns.whole(own.tau) if own.tau else np.zeros(len(t))
        wrench = np.stack([columns.whole(own.fx), columns.whole(own.fy), tau], axis=1)
        return Wrenches(t, wrench, own.frame == "table"), []
    valves = mapping.valves
    assert valves is not None  # load_mapping: one of the two
    share = np.stack([columns.whole(name) for name in valves.columns], axis=1)
    if valves.kind == "us":
        share = share * 1e-6 / valves.period_s
    for k, name in enumerate(valves.columns):
        column = share[:, k]
        odd = valves.kind == "state" and not np.isin(column, (0.0, 1.0)).all()
        if odd or column.min() < 0.0 or column.max() > 1.0 + 1e-3:
            raise LogRefusedError(
                where=f"{columns.where}, column {name!r}",
                expected="0 or 1" if valves.kind == "state" else "0 to 1 of the period",
                found=f"{column.min():g} to {column.max():g}",
                hint="a share in percent, or an open time: see `kind` of the mapping",
            )  # fmt: skip
    made = shares if valves.opens == "unknown" else pulses
    start, taken, note = periods(t, share, valves.period_s, valves.phase_s)
    return made(start, np.minimum(share[taken], 1.0), valves.period_s), note
