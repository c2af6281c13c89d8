"""Noisy cameras and a slope: what the estimator learns in its first second is no pull.

Healthy flights that `benchmarks/healthy.py --seed 84` had found to be stopped as `pulled_hard`.
"""

import pytest

from testbed.config import find, load
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin

WAY = ["vehicles.sat1.start=[-0.5,-0.5,0.0]", "vehicles.sat1.goal=[0.5,0.5,1.0]", "duration_s=27"]
FLIGHTS = {
    "a slope of 17 mm/s^2": """
        vehicles.*.model.valve.open_delay_s=0.0539096 vehicles.*.model.valve.close_delay_s=0.0490587
        vehicles.*.model.valve.min_on_s=0.0107584 vehicles.*.model.jets.*.thrust=0.38883
        vehicles.*.model.mass=20.1419 vehicles.*.model.inertia=0.322271
        vehicles.*.model.tolerance.thrust=0.050244 table.mocap.rate_hz=68.6785
        table.mocap.noise=0.000800749 table.mocap.noise_deg=0.120112 table.mocap.dropout_s=0.06
        table.mocap.dropout_rate=0.38419 table.link.loss=0.318703 table.link.burst_loss=0.5
        table.tilt.uniform=[0.00823505,-0.0148453] seed=370""",
    "weak jets": """
        vehicles.*.model.valve.open_delay_s=0.0163688 vehicles.*.model.valve.close_delay_s=0.0090926
        vehicles.*.model.valve.min_on_s=0.0342366 vehicles.*.model.jets.*.thrust=0.186578
        vehicles.*.model.mass=17.0447 vehicles.*.model.inertia=0.272715
        vehicles.*.model.tolerance.thrust=0.0271439 table.mocap.rate_hz=176.961
        table.mocap.noise=0.000637997 table.mocap.noise_deg=0.0956995 table.mocap.dropout_s=0.06
        table.mocap.dropout_rate=1.49035 table.link.loss=0.210034 table.link.burst_loss=0.5
        table.tilt.uniform=[0.00989671,0.0020434] seed=448""",
}


class Warned(NullObserver):
    """Notes rows of the fault table that hold."""

    def __init__(self):
        self.rows = set()

    def vehicle(self, name, tick):
        """See `Observer`."""
        self.rows |= set(tick.outputs.faults)


@pytest.mark.parametrize("flight", FLIGHTS)
def test_a_healthy_vehicle_is_not_pulled(flight):
    warned = Warned()
    ending = make_twin(load(find("hold"), [*WAY, *FLIGHTS[flight].split()])).fly(warned)
    assert ending.fault is None
    assert not warned.rows & {"pulled", "pulled_hard"}
