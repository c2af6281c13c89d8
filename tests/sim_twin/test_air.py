"""Gas that leaves takes pressure, mass and moments with it."""

import numpy as np
import pytest

from sim_twin.air import body_now, supply_share
from sim_twin.plant_parameters import sample_plant

OFF_CENTRE = {"com": (0.01, -0.02), "air": {"gas": 0.5, "tank_position": (-0.06, 0.09)}}


@pytest.mark.parametrize("used", [0.0, 0.1, 0.3, 0.5])
def test_what_is_left_and_what_has_left_make_the_full_vehicle(make_vehicle, used):
    vehicle = make_vehicle(**OFF_CENTRE)
    mass, inertia, *com = body_now(sample_plant({"a": vehicle}, 0), 0, used)
    com, tank, full = np.array(com), np.array(vehicle.air.tank_position), np.array(vehicle.com)
    assert mass + used == pytest.approx(vehicle.mass)
    assert (mass * com + used * tank) / vehicle.mass == pytest.approx(full)
    about_full = inertia + mass * ((com - full) ** 2).sum() + used * ((tank - full) ** 2).sum()
    assert about_full == pytest.approx(vehicle.inertia)


@pytest.mark.parametrize(
    ("tank_pressure", "share"),
    [(20e6, 1.0), (0.61e6, 1.0), (0.60e6, 1.0), (0.35e6, 0.5), (0.1e6, 0.0), (0.0, 0.0)],
)
def test_the_regulator_holds_until_the_tank_is_nearly_empty(make_vehicle, tank_pressure, share):
    vehicle = make_vehicle()
    air = vehicle.air
    assert (air.set_pressure, air.dropout) == (0.5e6, 0.1e6)
    used = air.gas * (1.0 - tank_pressure / air.tank_pressure)
    assert supply_share(sample_plant({"a": vehicle}, 0), 0, used) == pytest.approx(share, abs=1e-9)
    assert air.supply_pressure(air.gas - used) == pytest.approx(share * 0.5e6, abs=1e-3)


def test_nothing_is_used_that_is_not_there(make_vehicle, make_plant, make_plan):
    plant = make_plant(
        [make_vehicle(air={"gas": 0.01, "exhaust_speed": 100.0, "bearing_flow": 1e-3})],
        [[0.0] * 6],
    )
    for k in range(30):
        plant.boards["0"].apply(make_plan(0.1 * k, dict.fromkeys((0, 4), (0.0, 0.1))))
        plant.advance(0.1 * (k + 1))
    assert plant.used[0] == pytest.approx(0.01, abs=1e-15)
    assert supply_share(plant.parameters, 0, plant.used[0]) == 0.0
    assert plant.impulse[0] < 0.01 * 100.0
