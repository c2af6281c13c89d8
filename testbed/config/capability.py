"""What a vehicle can do, in lines for `testbed check`."""

import math
from collections.abc import Iterator

import numpy as np

from testbed.config.experiment import Experiment
from testbed.config.fit import ability
from testbed.config.plausibility import gas_to_goal, quickest_s
from testbed.core.pulse import open_time, timing
from testbed.core.spelling import counted
from testbed.core.vehicle import Vehicle
from testbed.flight.allocation import in_numbers, weakest
from testbed.flight.parameters import SPARE_FORCE
from testbed.metrics.formation import has_formation


def abilities(experiment: Experiment, name: str) -> Iterator[str]:
    """Force, torque, acceleration; shortest pulse; way to the goal; stop from top speed.

    Forces are those without a torque, and the torque is the one without a force.
    """
    setup, own = experiment.vehicles[name], ability(experiment, name)
    model = setup.model
    along_x, along_y, torque = pure(model)
    force = min(along_x, along_y)
    jets = counted(len(model.jets), "jet")
    words = f"{jets}, {force:.2f} N per axis, {torque:.3g} N m, {force / model.mass:.2g} m/s^2"
    goes = setup.path is None and not has_formation(experiment.controller)
    if goes:
        move, turn = quickest_s(experiment, setup)
        words += f", at least {move:.3g} s to the place of the goal"
        words += f" and {turn:.3g} s for the turn" if turn else ""
    yield words
    yield (
        f"  along x {along_x:.3g} N, along y {along_y:.3g} N, without a torque; in the weakest"
        f" direction {own.accel:.2g} m/s^2, turning {own.spin:.2g} rad/s^2"
    )
    least = shortest_impulse(model)
    yield (
        f"  shortest pulse {1e3 * model.valve.min_on_s:g} ms: {1e3 * least:.2g} mN s,"
        f" {1e3 * least / model.mass:.2g} mm/s"
    )
    if goes:
        gas = gas_to_goal(experiment, setup)
        yield f"  about {1e3 * gas:.2g} g of {1e3 * model.air.gas:g} g gas to the goal"
    speed, decel = experiment.flight.barrier.max_speed, SPARE_FORCE * own.accel
    yield (
        f"  stop from {speed:.2g} m/s: {speed**2 / (2.0 * decel):.2g} m in {speed / decel:.2g} s"
        " with all jets"
    )


def pure(vehicle: Vehicle) -> tuple[float, float, float]:
    """Largest force along x and along y without a torque [N], and torque without a force [N m].

    Of the two ways along an axis the weaker one counts. No two jets that push against each other
    are open, as in flight.
    """
    (fx, fy, tau), gas, opposing = in_numbers(vehicle.jets, vehicle.com)
    plenty, both_ways = 2.0 * (gas.sum() + np.abs(tau).sum()), 2
    # `weakest` looks along the first row for a demand without the third
    rows = (fx, fy, tau), (fy, fx, tau), (tau, fx, fy)
    found = [weakest(np.array(one), gas, opposing, both_ways, plenty) for one in rows]
    return found[0], found[1], found[2]


def shortest_impulse(vehicle: Vehicle) -> float:
    """Impulse of the shortest pulse of the strongest jet [N s]."""
    flows = open_time(0.0, vehicle.valve.min_on_s, timing(vehicle.valve), 0.0, math.inf)
    return max(jet.thrust for jet in vehicle.jets) * float(flows)
