"""What a vehicle can do, in lines for `testbed check`."""

import math
from collections.abc import Iterator

from testbed.config.experiment import Experiment
from testbed.config.fit import ability
from testbed.config.hardware import WAYS, strength
from testbed.config.plausibility import gas_to_goal, quickest_s
from testbed.core.pulse import open_time, timing
from testbed.core.vehicle import Vehicle
from testbed.flight.parameters import SPARE_FORCE
from testbed.metrics.formation import has_formation


def abilities(experiment: Experiment, name: str) -> Iterator[str]:
    """Force, torque, acceleration; shortest pulse; way to the goal; stop from top speed."""
    setup, can = experiment.vehicles[name], strength(experiment.vehicles[name].model)
    model, own = setup.model, ability(experiment, name)
    force, torque = min(can[way] for way in WAYS[:4]), min(can[way] for way in WAYS[4:])
    jets = f"{len(model.jets)} jet{'s' * (len(model.jets) != 1)}"
    words = f"{jets}, {force:.2f} N per axis, {torque:.3g} N m, {force / model.mass:.2g} m/s^2"
    goes = setup.path is None and not has_formation(experiment.controller)
    if goes:
        words += f", at least {quickest_s(experiment, setup):.3g} s from start to goal"
    yield words
    yield (
        f"  along x {min(can[way] for way in WAYS[:2]):.3g} N, along y"
        f" {min(can[way] for way in WAYS[2:4]):.3g} N; in the weakest direction {own.accel:.2g}"
        f" m/s^2, turning {own.spin:.2g} rad/s^2"
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


def shortest_impulse(vehicle: Vehicle) -> float:
    """Impulse of the shortest pulse of the strongest jet [N s]."""
    flows = open_time(0.0, vehicle.valve.min_on_s, timing(vehicle.valve), 0.0, math.inf)
    return max(jet.thrust for jet in vehicle.jets) * float(flows)
