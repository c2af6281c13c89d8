"""`predict`: the motion of a vehicle ahead of a state, with the plant's physics and no noise."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_twin.ground import Ground, lay
from sim_twin.plant_parameters import PlantParameters, nominal_plant
from sim_twin.prediction import shoot
from sim_twin.schedule import Schedule, schedule_of_pulses, schedule_of_wrenches
from testbed.core.error import TestbedError
from testbed.core.table import Table
from testbed.core.vehicle import Vehicle

Array = NDArray[np.float64]
LEVEL = Ground(np.array([1e3, 1e3]), np.zeros(2), np.zeros((0, 0, 2)), 0.0, np.zeros((0, 4)))


class Valves(NamedTuple):
    """Commanded valve pulses: jet `jet[i]` from `up[i]` to `down[i]`, sorted by `up`."""

    up: Array  # (n,) opening commands [s]
    down: Array  # (n,) closing commands [s]
    jet: NDArray[np.int64]  # (n,) index of the jet in the vehicle file, from 0
    share: Array | None = None  # (n,) of the time open, where the times within are not known


class Wrenches(NamedTuple):
    """Commanded wrenches, each held until the next."""

    t: Array  # (n,) [s]
    wrench: Array  # (n, 3) fx, fy, tau about the body's origin [N, N, N m]
    in_table: bool = False  # forces are along the axes of the table, not of the body


Inputs = Valves | Wrenches


def pulses(t: Any, share: Any, period: float) -> Valves:
    """Valve pulses from commands that are taken at `t` and open each valve for a share of `period`.

    Args:
        t: times of the commands, shape (n,) [s].
        share: open share of each jet, shape (n, jets), 0 to 1.
        period: [s].
    """
    t, share = np.asarray(t, dtype=float), np.asarray(share, dtype=float)
    held = _held(t, period)
    rows, jets = np.nonzero(share > 0.0)
    order = np.lexsort((rows, jets))
    rows, jets = rows[order], jets[order]
    up = t[rows]
    down = up + share[rows, jets] * held[rows]
    joined = np.zeros(len(up), dtype=bool)  # continues the pulse before
    if len(up) > 1:
        joined[1:] = (jets[1:] == jets[:-1]) & (up[1:] - down[:-1] < 1e-6)
    first = np.flatnonzero(~joined)
    last = np.append(first[1:], len(up)) - 1 if len(first) else first
    by_time = np.argsort(up[first], kind="stable")
    first, last = first[by_time], last[by_time]
    return Valves(up[first], down[last], jets[first].astype(np.int64))


def shares(t: Any, share: Any, period: float) -> Valves:
    """As `pulses`, where the times of a valve within its period are not known.

    Each valve is taken as open for its share throughout the period.
    """
    t, share = np.asarray(t, dtype=float), np.asarray(share, dtype=float)
    rows, jets = np.nonzero(share > 0.0)
    until = t + _held(t, period)
    return Valves(t[rows], until[rows], jets.astype(np.int64), share[rows, jets])


def _held(t: Array, period: float) -> Array:
    """How long each row's command lasts: until the next, or a period before a gap [s]."""
    until = np.append(t[1:], t[-1] + period) if len(t) else t
    return np.where(until - t < 1.5 * period, until - t, period)


def schedule_of(inputs: Inputs, plant: PlantParameters, delay: float) -> Schedule:
    """The body wrench that a vehicle makes of its inputs."""
    timing = plant.timing[0]
    if isinstance(inputs, Valves):
        far = np.ones(len(inputs.up))
        if inputs.share is not None:  # a valve that closes later is open for a larger share
            longer = (timing[1] - timing[0]) / (inputs.down - inputs.up)
            far = np.clip(inputs.share + longer, 0.0, 1.0)
            timing = timing[[0, 0, 2, 2]]
        return schedule_of_pulses(
            inputs.up, inputs.down, inputs.jet, far, delay, timing, plant.effect[0],
            plant.thrust[0], plant.droop[0], inputs.share is not None,
        )  # fmt: skip
    return schedule_of_wrenches(inputs.t, inputs.wrench, delay + timing[0], timing[2])


def used_before(schedule: Schedule, plant: PlantParameters, t: Array) -> Array:
    """Gas that jets and bearings have used since the first command, at most half a tank [kg].

    The tank's level at the start of a log is not known: it is taken as full, and the supply of a
    long log is not predicted to end.
    """
    width = np.diff(schedule.start)
    impulse = width * (schedule.value[:, 3] + 0.5 * width * schedule.slope[:, 3])
    total = np.concatenate([[0.0], np.cumsum(impulse)]) / plant.exhaust_speed[0]
    used = np.interp(t, schedule.start, total)
    used += plant.bearing_flow[0] * np.maximum(t - schedule.start[0], 0.0)
    return np.minimum(used, 0.5 * plant.gas[0])


def predict(vehicle: Vehicle, table: Table | None, inputs: Inputs, x0: Any, times: Any) -> Array:
    """Predict the motion of a vehicle from a state under known commands.

    Delays are smooth parameters: the result is differentiable in every number of the vehicle.

    Args:
        vehicle: its values are taken as exact, without tolerances; the tank is full at the start.
        table: slope of the surface; None: level. There are no edges and no contacts.
        inputs: `Valves` or `Wrenches`, whole log; earlier commands act on the start.
        x0: state at the first of `times`: x, y, theta, vx, vy, omega of the body's origin
            [m, m, rad, m/s, m/s, rad/s].
        times: increasing, shape (n,) [s].

    Returns:
        states at the times, shape (n, 6).
    """
    marks, start = np.array(times, dtype=float), np.array(x0, dtype=float)
    if start.shape != (6,) or marks.ndim != 1 or len(marks) < 1 or np.any(np.diff(marks) < 0.0):
        raise TestbedError(
            where="predict", expected="x0 of shape (6,) and increasing times, shape (n,)",
            found=f"x0 of shape {start.shape}, times of shape {marks.shape}",
        )  # fmt: skip
    if not (np.isfinite(start).all() and np.isfinite(marks).all()):
        raise TestbedError(where="predict", expected="finite x0 and times", found="nan or inf")
    plant = nominal_plant(vehicle)
    if isinstance(inputs, Valves) and len(inputs.jet) and max(inputs.jet) >= len(vehicle.jets):
        raise TestbedError(
            where="predict", expected=f"jet indices 0 to {len(vehicle.jets) - 1}; 0 is jet 1",
            found=f"{max(inputs.jet)}",
        )  # fmt: skip
    ground = LEVEL if table is None else lay(table)
    schedule = schedule_of(inputs, plant, vehicle.command_delay_s)
    in_table = isinstance(inputs, Wrenches) and inputs.in_table
    return shoot(
        start[None], np.zeros(1), marks[:1], marks[None], schedule, plant, ground, in_table
    )[0]
