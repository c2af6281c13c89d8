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
from testbed.run.arguments import wrong

Array = NDArray[np.float64]
CALL = "testbed.predict"
LEVEL = Ground(np.array([1e3, 1e3]), np.zeros(2), np.zeros((0, 0, 2)), 0.0, np.zeros((0, 4)))


class Valves(NamedTuple):
    """Commanded valve pulses: jet `jet[i]` from `up[i]` to `down[i]`."""

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
    """Valves from open shares, where the times of a valve within its period are not known.

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
        inputs: `Valves` or `Wrenches`, whole log, in any order; earlier commands act on the start.
        x0: state at the first of `times`: x, y, theta, vx, vy, omega of the body's origin
            [m, m, rad, m/s, m/s, rad/s].
        times: increasing, shape (n,) [s].

    Returns:
        states at the times, shape (n, 6).

    Raises:
        TestbedError: an argument has another shape or is not finite, a jet does not exist, or a
            valve closes before it opens.
    """
    if not isinstance(vehicle, Vehicle):
        hint = 'testbed.load("hold").vehicles["sat1"].model'
        raise wrong(f"{CALL}, vehicle", "the model of a vehicle", vehicle, hint)
    if not isinstance(table, Table | None):
        hint = 'testbed.load("hold").table'
        raise wrong(f"{CALL}, table", "the table of an experiment, or None: level", table, hint)
    start, marks = _numbers("x0", x0, (6,)), _numbers("times", times, (None,))
    if len(marks) < 1 or np.any(np.diff(marks) < 0.0):
        raise wrong(f"{CALL}, times", "increasing times, one or more", times)
    if isinstance(inputs, Valves):
        inputs = _checked_valves(inputs, len(vehicle.jets))
    elif isinstance(inputs, Wrenches):
        inputs = _checked_wrenches(inputs, float(marks[0]))
    else:
        hint = "testbed.Valves(up=[0.0], down=[0.4], jet=[0])"
        raise wrong(f"{CALL}, inputs", "testbed.Valves or testbed.Wrenches", inputs, hint)
    plant = nominal_plant(vehicle)
    ground = LEVEL if table is None else lay(table)
    schedule = schedule_of(inputs, plant, vehicle.command_delay_s)
    in_table = isinstance(inputs, Wrenches) and inputs.in_table
    return shoot(
        start[None], np.zeros(1), marks[:1], marks[None], schedule, plant, ground, in_table
    )[0]


def _checked_valves(inputs: Valves, jets: int) -> Valves:
    """The pulses as arrays, sorted by `up`, with jets that exist: compiled code checks nothing."""
    up = _numbers("inputs.up", inputs.up, (None,))
    down = _numbers("inputs.down", inputs.down, up.shape)
    number = _numbers("inputs.jet", inputs.jet, up.shape)
    share = None if inputs.share is None else _numbers("inputs.share", inputs.share, up.shape)
    jet = number.astype(np.int64)
    _all("inputs.jet", "whole numbers; 0 is jet 1", number, jet == number)
    there = (jet >= 0) & (jet < jets)
    _all("inputs.jet", f"jet indices 0 to {jets - 1}; 0 is jet 1", jet, there)
    # the mean opening of a share needs a time to be the mean of
    long_enough = down >= up if share is None else down > up
    expected = "no valve that closes before it opens: up, then down"
    _all("inputs.down", expected, down - up, long_enough, "s after `up`")
    if share is not None:
        _all("inputs.share", "shares of the time, 0 to 1", share, (share >= 0.0) & (share <= 1.0))
    order = np.argsort(up, kind="stable")
    return Valves(up[order], down[order], jet[order], None if share is None else share[order])


def _checked_wrenches(inputs: Wrenches, begin: float) -> Wrenches:
    """The wrenches as arrays, sorted by time; without a row, none from `begin` on [s]."""
    t = _numbers("inputs.t", inputs.t, (None,))
    if len(t) == 0:
        return Wrenches(np.array([begin]), np.zeros((1, 3)), bool(inputs.in_table))
    wrench = _numbers("inputs.wrench", inputs.wrench, (len(t), 3))
    order = np.argsort(t, kind="stable")
    t, wrench = t[order], wrench[order]
    apart = np.diff(t)
    _all("inputs.t", "times more than 1 us apart", apart, apart > 1e-6, "s apart")
    return Wrenches(t, wrench, bool(inputs.in_table))


def _numbers(what: str, value: Any, shape: tuple[int | None, ...]) -> Array:
    """Finite numbers of a shape, None for any length, as a new array.

    Raises:
        TestbedError: it is something else; `what` is the argument.
    """
    where = f"{CALL}, {what}"
    expected = f"finite numbers of shape {str(shape).replace('None', 'n')}"
    try:
        found = np.asarray(value)
    except ValueError:  # rows of different lengths
        raise wrong(where, expected, value) from None
    if found.size and found.dtype.kind not in "iuf":
        raise wrong(where, expected, value)
    fits = found.ndim == len(shape) and all(
        n in (None, m) for n, m in zip(shape, found.shape, strict=True)
    )
    if not fits:
        raise TestbedError(where=where, expected=expected, found=f"shape {found.shape}")
    _all(what, expected, found, np.isfinite(found))
    return np.array(found, dtype=float, order="C")


def _all(what: str, expected: str, values: Any, good: Any, unit: str = "") -> None:
    """Refuse values if not all are good: name the first that is not.

    Raises:
        TestbedError: one is not good; `what` is the argument.
    """
    if np.all(good):
        return
    at = tuple(np.argwhere(~good)[0].tolist())
    found = f"{values[at]:g}{' ' * bool(unit)}{unit} at index {at[0] if len(at) == 1 else at}"
    raise TestbedError(where=f"{CALL}, {what}", expected=expected, found=found)
