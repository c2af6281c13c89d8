"""`testbed excite`: valve commands that tell most about a vehicle, within fence, gas and time.

Random experiments are flown in the twin; the one with the largest Fisher information (log of the
determinant, relative to what is known before) is kept. Its inverse predicts the intervals.
"""

import csv
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_twin.plant_parameters import nominal_plant
from testbed.core.error import TestbedError
from testbed.core.table import Table
from testbed.core.vehicle import Vehicle
from testbed.identification.estimate import linearise
from testbed.identification.linearised import normal
from testbed.identification.model import VehicleModel
from testbed.identification.motion import IDENTIFIABLE, SURE
from testbed.identification.motion_log import MotionLog
from testbed.identification.prediction import Valves, schedule_of, used_before
from testbed.identification.synthetic import excitation, flown_log
from testbed.identification.windows import first_guess, tiled

Array = NDArray[np.float64]
TRIES = 12


class Design(NamedTuple):
    """An experiment: commands, and what they will tell."""

    inputs: Valves
    log: MotionLog  # as the twin expects it, without noise
    intervals: dict[str, dict[str, Any]]  # of each parameter
    information: float  # log det, relative to the prior
    gas: float  # [kg]
    reach: float  # largest distance from the start, in x or y [m]


def design(
    vehicle: Vehicle, table: Table, seconds: float, room: float, gas: float | None = None,
    period: float = 0.1, seed: int = 0,
) -> Design:  # fmt: skip
    """The best of some random experiments.

    Args:
        vehicle: as its file has it.
        table: noise of its cameras, and its slope.
        seconds: length of the experiment.
        room: distance from the start in x and y that it may use [m].
        gas: that it may use [kg]; None: half a tank.
        period: of the valve commands [s].
        seed: of the random experiments.

    Raises:
        TestbedError: none stays within room and gas.
    """
    most = gas if gas is not None else 0.5 * vehicle.air.gas
    found = [_one(vehicle, table, seconds, room, period, seed + k) for k in range(TRIES)]
    allowed = [one for one in found if one.gas <= most and one.reach <= room]
    if not allowed:
        least = min(found, key=lambda one: max(one.gas / most, one.reach / room))
        raise TestbedError(
            where="excite", expected=f"an experiment within {room:g} m and {1e3 * most:g} g of gas",
            found=f"at best {least.reach:.2f} m and {1e3 * least.gas:.1f} g in {seconds:g} s",
            hint="a shorter experiment" + ", or more room" * (least.reach > room)
            + ", or more gas" * (least.gas > most),
        )  # fmt: skip
    return max(allowed, key=lambda one: one.information)


def _one(
    vehicle: Vehicle, table: Table, seconds: float, room: float, period: float, seed: int
) -> Design:
    rng = np.random.default_rng(seed)
    slope = table.tilt.uniform
    inputs = excitation(vehicle, seconds, period, rng, room=0.5 * room, slope=slope)
    rate = min(50.0, table.mocap.rate_hz)
    log = flown_log(vehicle, table, inputs, seconds, rng, rate, 0.0, 0.0)
    model = VehicleModel(vehicle, valves=True, table=table)
    windows = tiled(log, log.window_s)
    free = np.arange(len(model.names))
    noise = np.radians(table.mocap.noise_deg)
    scales = np.array([table.mocap.noise, table.mocap.noise, noise])
    states = [first_guess(windows, np.isfinite(windows.marks))]
    pieces = linearise(model, model.prior, free, [windows], states, np.maximum(scales, 1e-6))
    matrix, _ = normal(pieces, np.ones(len(windows.rows)))
    known = np.diag(model.sigma)
    relative = known @ matrix @ known + np.eye(len(free))
    covariance = known @ np.linalg.inv(relative) @ known
    sigma = np.sqrt(np.diag(covariance))
    intervals = {
        own.name: {"half_width": float(SURE * sigma[k]), "unit": own.unit or "1",
                   "identifiable": bool(sigma[k] < IDENTIFIABLE * own.sigma)}
        for k, own in enumerate(model.parameters) if own.group not in ("thrust", "jets")
    }  # fmt: skip
    before = float(np.hypot(model.sigma[0], model.sigma[1]))
    for j in range(len(vehicle.jets)):  # the scale of all, and its own
        both = covariance[np.ix_([0, 1 + j], [0, 1 + j])].sum() ** 0.5
        intervals[f"thrust of jet {j + 1}"] = {
            "half_width": float(SURE * both), "unit": "1",
            "identifiable": bool(both < IDENTIFIABLE * before),
        }  # fmt: skip
    plant = nominal_plant(vehicle)
    schedule = schedule_of(inputs, plant, vehicle.command_delay_s)
    gas = float(used_before(schedule, plant, np.array([seconds]))[0])
    reach = float(np.abs(log.pose[:, :2]).max())
    return Design(inputs, log, intervals, float(np.linalg.slogdet(relative)[1]), gas, reach)


def write_commands(path: Path, found: Design, jets: int, period: float) -> None:
    """Write the commands as CSV: time, and the open time of each jet in the period [us].

    Raises:
        TestbedError: the path cannot be written.
    """
    count = round(float(found.inputs.down.max(initial=0.0)) / period) + 1
    on = np.zeros((count, jets))
    for up, down, jet in zip(*found.inputs[:3], strict=True):
        for k in range(int(up / period + 1e-6), count):
            part = min(down, period * (k + 1)) - max(up, period * k)
            if part <= 0.0:
                break
            on[k, jet] += part
    try:
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["t_s", *(f"on_us_{j + 1}" for j in range(jets))])
            for k, row in enumerate(on):
                writer.writerow([f"{period * k:.6g}", *(round(1e6 * value) for value in row)])
    except OSError as error:
        raise TestbedError(
            where=str(path), expected="a writable path", found=error.strerror or str(error)
        ) from None
