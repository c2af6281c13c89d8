"""Flights of the plant with known numbers, as motion logs: for tests and to design excitations."""

from typing import NamedTuple

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from testbed.core.table import Table
from testbed.core.vehicle import Vehicle
from testbed.identification.motion_log import MotionLog
from testbed.identification.prediction import Valves, predict, pulses

Array = NDArray[np.float64]


class DrawnSpread(NamedTuple):
    """Standard deviations of a drawn vehicle."""

    thrust: float = 0.10
    inertia: float = 0.10
    com: float = 0.003  # [m]
    delay: float = 0.01  # [s]
    droop: float = 0.05


USUAL = DrawnSpread()


def drawn(vehicle: Vehicle, rng: np.random.Generator, spread: DrawnSpread = USUAL) -> Vehicle:
    """A vehicle with true values near those of the file."""
    jets = [
        structs.replace(j, thrust=j.thrust * float(np.exp(spread.thrust * rng.standard_normal())))
        for j in vehicle.jets
    ]
    later = abs(spread.delay * float(rng.standard_normal()))
    valve = structs.replace(
        vehicle.valve, open_delay_s=vehicle.valve.open_delay_s + later,
        close_delay_s=vehicle.valve.close_delay_s + later,
    )  # fmt: skip
    com = tuple(float(c + spread.com * rng.standard_normal()) for c in vehicle.com)
    droop = vehicle.air.droop + abs(spread.droop * float(rng.standard_normal()))
    return structs.replace(
        vehicle, jets=jets, valve=valve, com=com,
        inertia=vehicle.inertia * float(np.exp(spread.inertia * rng.standard_normal())),
        air=structs.replace(vehicle.air, droop=droop),
    )  # fmt: skip


def excitation(
    vehicle: Vehicle, seconds: float, period: float, rng: np.random.Generator,
    used: NDArray[np.bool_] | None = None, room: float = 1.0,
    slope: tuple[float, float] = (0.0, 0.0), start: Array | None = None,
) -> Valves:  # fmt: skip
    """Random pulses of one to three jets, steered so that the vehicle stays within `room` [m].

    Args:
        vehicle: as the file has it.
        seconds: length.
        period: of the commands [s].
        rng: random numbers.
        used: jets that may be opened; None: all.
        room: distance from the start at which it is pushed back [m].
        slope: of the table, as a pilot would feel it [m/s^2].
        start: state, see `predict`; None: at rest in the origin.
    """
    jets = len(vehicle.jets)
    allowed = np.ones(jets, dtype=bool) if used is None else used
    count = round(seconds / period)
    share = np.zeros((count, jets))
    effect = np.array([
        [j.thrust * j.push[0], j.thrust * j.push[1],
         (j.position[0] * j.push[1] - j.position[1] * j.push[0]) * j.thrust]
        for j in vehicle.jets
    ])  # fmt: skip
    x = np.zeros(6) if start is None else start.copy()
    step = 0
    while step < count:
        held = int(rng.integers(3, 12))
        best: tuple[float, Array] | None = None
        for _ in range(12):
            chosen = rng.choice(np.flatnonzero(allowed), size=int(rng.integers(1, 4)))
            trial = np.zeros(jets)
            trial[chosen] = rng.uniform(0.2, 1.0, size=len(chosen))
            wrench = trial @ effect
            c, s = np.cos(x[2]), np.sin(x[2])
            push = np.array([c * wrench[0] - s * wrench[1], s * wrench[0] + c * wrench[1]])
            v = x[3:5] + push / vehicle.mass * held * period
            w = x[5] + wrench[2] / vehicle.inertia * held * period
            ahead = x[:2] + 4.0 * v
            cost = float(ahead @ ahead) / room**2 + 30.0 * float(v @ v) + 4.0 * w * w
            cost += 0.3 * float(rng.random())
            if best is None or cost < best[0]:
                best = cost, trial
        assert best is not None
        end = min(count, step + held)
        share[step:end] = best[1]
        wrench = best[1] @ effect
        for _ in range(step, end):
            c, s = np.cos(x[2]), np.sin(x[2])
            x[3] += period * (c * wrench[0] - s * wrench[1]) / vehicle.mass
            x[4] += period * (s * wrench[0] + c * wrench[1]) / vehicle.mass
            x[5] += period * wrench[2] / vehicle.inertia
            x[3:5] += period * np.array(slope)
            x[:3] += period * x[3:]
        rest = min(count, end + int(rng.integers(0, 6)))
        x[3:5] += (rest - end) * period * np.array(slope)
        x[:3] += (rest - end) * period * x[3:]
        step = rest
    return pulses(period * np.arange(count), share, period)


def steered(
    truth: Vehicle, table: Table, file: Vehicle, seconds: float, period: float,
    rng: np.random.Generator, used: NDArray[np.bool_] | None = None, part: float = 5.0,
    room: float = 2.5,
) -> Valves:  # fmt: skip
    """An excitation in parts of `part` seconds, each planned from where the vehicle really is.

    So the vehicle stays on the table, though the file that it is planned with is not true.
    """
    found: list[Valves] = []
    x, slope = np.zeros(6), table.tilt.uniform
    for begin in np.arange(0.0, seconds - 1e-9, part):
        now = excitation(file, min(part, seconds - begin), period, rng, used, room, slope, x)
        found.append(Valves(now.up + begin, now.down + begin, now.jet))
        inputs = Valves(*map(np.concatenate, zip(*(one[:3] for one in found), strict=True)))
        x = predict(truth, table, inputs, np.zeros(6), [0.0, begin + part])[-1]
    return inputs


def flown_log(
    vehicle: Vehicle, table: Table | None, inputs: Valves, seconds: float,
    rng: np.random.Generator, rate: float = 20.0, noise: float = 2e-4, noise_rad: float = 5e-4,
) -> MotionLog:  # fmt: skip
    """The log of a flight from rest, with white noise on the poses."""
    t = np.arange(0.0, seconds, 1.0 / rate)
    state = predict(vehicle, table, inputs, np.zeros(6), t)
    pose = state[:, :3] + rng.standard_normal((len(t), 3)) * [noise, noise, noise_rad]
    return MotionLog("synthetic", "", t, pose, np.ones(len(t), dtype=bool), inputs, [])


def rough(table: Table, rng: np.random.Generator, slope: float, bumps: float) -> Table:
    """The table with a uniform slope and a random map, each of standard deviation [m/s^2]."""
    uniform = tuple(float(a) for a in slope * rng.standard_normal(2))
    nodes = bumps * rng.standard_normal((9, 9, 2))
    nodes -= nodes.mean(axis=(0, 1))
    rows = [[(float(a[0]), float(a[1])) for a in row] for row in nodes]
    return structs.replace(table, tilt=structs.replace(table.tilt, uniform=uniform, map=rows))
