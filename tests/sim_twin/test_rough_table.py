"""What a rough table does to a vehicle: friction, hoses, late valves, bodies that are off."""

import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from sim_twin.camera import Cameras
from sim_twin.plant import Plant
from sim_twin.plant_parameters import sample_plant
from testbed.config import SHIPPED, find, load
from testbed.config.tree import read_toml
from testbed.core.table import Patch, Spread, Table
from testbed.core.types import Pose, ValveCommand
from testbed.rig.observers import MetricsObserver
from testbed.rig.twin import make_twin

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
from slope_map import lines, slope_map

LEVEL = {"tilt": {"uniform": [0.0, 0.0]}}


@pytest.fixture
def plant_on(shipped_vehicle, make_table):
    def make(vehicle=shipped_vehicle, **changes):
        table = replace(make_table(**LEVEL), **changes)
        return Plant({"a": vehicle}, {"a": Pose(0.0, 0.0, 0.0)}, table, {}, 1)

    return make


def test_friction_slows_inside_its_patch_alone(plant_on):
    plant = plant_on(friction=[Patch((1.1, 0.0), 0.6, 0.02)])
    plant.x[0, 3] = 0.2
    plant.advance(2.5)
    assert plant.x[0, 3] == pytest.approx(0.2, abs=1e-9)  # at its rim
    plant.advance(3.5)
    assert plant.x[0, 3] == pytest.approx(0.2 - 0.02, abs=1e-4)
    for second in range(4, 30):
        plant.advance(float(second))
    assert abs(plant.x[0, 3]) < 1e-4


def test_a_hose_pulls_and_turns(plant_on):
    plant = plant_on()
    plant.parameters.hose[0] = 0.05, -0.02, 0.004
    plant.advance(1.0)
    mass, inertia = plant.parameters.mass[0], plant.parameters.inertia[0]
    assert plant.x[0, 3:5] * mass == pytest.approx(
        [0.05, -0.02], rel=0.05
    )  # of the body, not of its centre
    assert plant.x[0, 5] * inertia == pytest.approx(0.004, rel=0.02)


def test_a_late_valve_pushes_later(plant_on):
    def way(late):
        plant = plant_on()
        plant.parameters.late[0, 4] = late
        plan = ValveCommand(1, 0.0, 0.3, (0, 0, 0, 0, 200_000, 0, 0, 0), (0,) * 8)
        plant.boards["a"].apply(plan)
        plant.advance(1.0)
        return plant.x[0, 0], plant.x[0, 3]

    (x, v), (later_x, later_v) = way(0.0), way(0.05)
    assert later_v == pytest.approx(v, rel=1e-3)
    assert x - later_x == pytest.approx(0.05 * v, rel=1e-2)


def test_the_lab_spreads_what_the_files_do_not_know(shipped_vehicle):
    fleet = {str(k): shipped_vehicle for k in range(1000)}
    plain = sample_plant(fleet, 1)
    lab = Spread(thrust=0.1, delay_s=0.004, hose=0.01, hose_torque=0.0005)
    rough = sample_plant(fleet, 1, lab)
    stronger = rough.thrust / plain.thrust
    assert np.ptp(stronger, axis=1).max() < 1e-12  # all jets of a vehicle together
    assert stronger[:, 0].std() == pytest.approx(0.1, rel=0.1)
    assert rough.late.std() == pytest.approx(0.004, rel=0.05)
    assert rough.hose[:, :2].std() == pytest.approx(0.01, rel=0.05)
    assert rough.hose[:, 2].std() == pytest.approx(0.0005, rel=0.1)
    assert not plain.late.any()
    assert not plain.hose.any()
    assert (rough.mass == plain.mass).all()


def test_bodies_and_clock_of_the_cameras_are_off_by_a_constant(make_table):
    def seen(theta, **lab):
        mocap = replace(make_table().mocap, noise=0.0, noise_deg=0.0, dropout_rate=0.0)
        cameras = Cameras(["a"], mocap, 5, Spread(**lab))
        cameras.expose(np.zeros(1), np.array([[[0.5, 0.2, theta, 0, 0, 0]]]), 1.0)
        return cameras.arrived(0)[0]

    assert seen(0.0).captured_at == 0.0
    lab = {"body": 0.003, "body_deg": 0.5, "clock_s": 0.005}
    at, turned = seen(0.0, **lab), seen(np.pi / 2, **lab)
    dx, dy = at.x - 0.5, at.y - 0.2
    assert 0.0 < np.hypot(dx, dy) < 0.015
    assert (turned.x - 0.5, turned.y - 0.2) == pytest.approx((-dy, dx))  # it turns with the body
    assert 0.0 < abs(at.theta) < np.radians(2.5)
    assert 0.0 < abs(at.captured_at) < 0.025


@pytest.mark.parametrize("size", [4, 6])
def test_the_shipped_map_is_the_generators(size):
    grid = slope_map((float(size), float(size)), 1)
    assert 0.008 < grid.std() < 0.016  # of the measured plate: 0.009 and 0.016
    assert 0.025 < np.abs(grid).max() < 0.056
    file = SHIPPED / "tables" / f"rough_{size}m.toml"
    assert lines(grid) in file.read_text()
    assert msgspec.convert(read_toml(file), Table).size == (size, size)


def test_the_law_crosses_the_rough_table_without_a_false_alarm():
    """Its bumps look like a leak after half a minute, if nothing but a slope is thought of."""
    experiment = load(find("zhang2023_table_wrench_rough"), ["duration_s=36.0", "seed=1"])
    rig = make_twin(experiment)
    ending = rig.fly(MetricsObserver(experiment.vehicles))
    assert ending.fault is None
    assert not rig.touches
