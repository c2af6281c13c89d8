"""Defaults follow from the vehicle and the table; a number in a file overrides."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from msgspec.structs import replace
from scipy.optimize import linprog

from testbed.config import SHIPPED, dump, find, load, loads
from testbed.config.fit import defaults_of, most_torque, weakest_torque
from testbed.flight.allocation import weakest_force
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
from reach import VEHICLES, reach, settled_s

PLAIN = f"""
name = "plain"
duration_s = 20.0
table = "{SHIPPED}/tables/marble_6m.toml"
controller = {{ type = "pd" }}
[vehicles.sat1]
model = "{SHIPPED}/vehicles/generic_8jet.toml"
start = [-0.5, 0.0, 0.0]
goal = [0.5, 0.0, 0.0]
"""


def derived(*overrides):
    experiment = loads(PLAIN, overrides)
    return {".".join(map(str, one.key)): one.value for one in defaults_of(experiment)}


def test_every_default_is_in_the_experiment():
    experiment = loads(PLAIN)
    for key, value, how in defaults_of(experiment):
        own = experiment
        for part in key:
            own = getattr(own, part)
        assert own == value
        assert how


@pytest.mark.parametrize("key", derived())
def test_a_number_in_the_file_overrides(key):
    value = 0.0123 if "pose_timeout" not in key else 0.4
    own = loads(PLAIN, [f"{key}={value}"])
    for part in key.split("."):
        own = getattr(own, part)
    assert own == value


def test_what_is_resolved_stays_when_it_is_loaded_again():
    experiment = loads(PLAIN, ["vehicles.sat1.model.mass=20.0"])
    text = tomli_w.dumps(dump(experiment))
    assert dump(loads(text)) == dump(experiment)


def test_a_weak_vehicle_uses_more_of_its_force_and_a_strong_one_turns_no_faster():
    weak = derived("vehicles.*.model.jets.*.thrust=0.2")
    strong = derived("vehicles.*.model.jets.*.thrust=1.5")
    usual = derived()
    assert usual["guidance.force_share"] == strong["guidance.force_share"] == 0.6
    # 2 x 5 % of spread and 2 of 32 mm/s^2 of slope are kept
    assert weak["guidance.force_share"] == pytest.approx(0.9 - 0.002 / 0.032)
    assert strong["guidance.heading_accel"] == 0.1
    assert weak["flight.barrier.max_speed"] < usual["flight.barrier.max_speed"] == 0.25
    assert weak["flight.ending.brake_s"] > usual["flight.ending.brake_s"] == 6.0
    assert strong["flight.estimator.force_noise"] > usual["flight.estimator.force_noise"]


def test_a_law_that_holds_against_the_slope_itself_keeps_the_force_for_it():
    """Before, the slope was taken off: of 24 mm/s^2, 45 % were left to hold against 8 mm/s^2."""
    steep = "vehicles.*.model.jets.*.thrust=0.2", "table.tilt.uniform=[0.008,0.0]"
    tracked, own = derived(*steep), derived(*steep, "guidance.mode=wrench")
    assert tracked["guidance.force_share"] == pytest.approx(0.9 - 0.008 / 0.032, abs=0.01)
    assert own["guidance.force_share"] == pytest.approx(0.9)
    assert derived("guidance.mode=wrench")["guidance.force_share"] == 0.6


@pytest.mark.parametrize(
    ("cameras", "age"),
    [((), 0.1), (("rate_hz=10", "latency_s=0.03"), 0.238), (("latency_s=0.12",), 0.148)],
)
def test_poses_of_slow_cameras_are_old_enough_to_arm(cameras, age):
    found = derived(*(f"table.mocap.{one}" for one in cameras))
    assert found["arming.pose_age_s"] == pytest.approx(age)


def test_slow_valves_narrow_the_loops():
    slow = derived("vehicles.*.model.valve.open_delay_s=0.2",
                   "vehicles.*.model.valve.close_delay_s=0.2")  # fmt: skip
    assert slow["flight.tracker.bandwidth"] == pytest.approx(0.125 / 0.272)
    assert slow["flight.tracker.heading_bandwidth"] == pytest.approx(0.25 / 0.272)


def test_a_steep_table_starts_the_estimator_uncertain():
    assert derived("table.tilt.uniform=[0.02,0.0]")["flight.estimator.bias_spread"] > 0.019


@pytest.mark.parametrize(
    "overrides",
    [
        ("vehicles.*.model.jets.*.thrust=1e-300",), ("vehicles.*.model.jets.*.thrust=1e9",),
        ("flight.estimator.force_noise=1e8",), ("flight.estimator.force_noise=1e-300",),
        ("flight.estimator.bias_walk=1e-200", "table.mocap.noise=0"),
        ("table.mocap.rate_hz=9999", "table.mocap.noise=1e8"), ("flight.barrier.effort=1e-300",),
        ("table.size=[0.9,0.9]",), ("vehicles.*.model.mass=1e9", "vehicles.*.model.inertia=1e7"),
    ],
)  # fmt: skip
def test_no_number_that_is_allowed_makes_a_default_that_is_not(overrides):
    where = ("vehicles.sat1.start=[0.0,0.0,0.0]", "vehicles.sat1.goal=[0.0,0.0,0.0]")
    experiment = loads(PLAIN, [*overrides, *where])
    assert all(0.0 < one.value < 1e9 for one in defaults_of(experiment))
    assert dump(loads(tomli_w.dumps(dump(experiment)))) == dump(experiment)


@pytest.mark.parametrize(
    ("mode", "period", "life"),
    [
        ("reference", 0.02, 0.5), ("reference", 0.1, 0.5), ("reference", 0.2, 1.3),
        ("reference", 0.5, 3.7), ("reference", 1.0, 7.7),
        ("wrench", 0.02, 0.5), ("wrench", 0.1, 0.5), ("wrench", 0.5, 1.75), ("wrench", 1.0, 3.5),
    ],
)  # fmt: skip
def test_references_outlive_a_burst_of_lost_ones_and_demands_two(mode, period, life):
    numbers = derived(f"flight.jet_period_s={period}", f"guidance.mode={mode}")
    assert numbers["guidance.setpoint_life_s"] == life


def test_the_torque_without_a_force_of_the_shipped_vehicle():
    model = loads(PLAIN).vehicles["sat1"].model
    assert weakest_torque(model) == pytest.approx(4 * 0.6 * 0.09)
    # without the second jet a pair is left, and the forces of the rest must still cancel
    seven = replace(model, jets=[jet for k, jet in enumerate(model.jets) if k != 1])
    assert weakest_torque(seven) < weakest_torque(model)


def test_the_shipped_experiments_have_the_numbers_they_have_always_had():
    for path in (SHIPPED / "experiments").glob("*.toml"):
        experiment = load(find(path.stem))
        tracker, guidance = experiment.flight.tracker, experiment.guidance
        assert (tracker.bandwidth, tracker.heading_bandwidth, tracker.brake_decel) == (
            0.8, 1.5, 0.03,
        )  # fmt: skip
        assert guidance.heading_accel == 0.02
        assert guidance.force_share in (0.6, 1.0)
        assert experiment.flight.barrier.max_speed == 0.25
        assert experiment.flight.estimator.force_noise == 1.5e-3


@pytest.mark.parametrize("name", VEHICLES)
def test_a_labs_vehicle_reaches_its_goal_with_default_gains(name):
    assert settled_s(reach(name), seed=0) <= 15.0


def test_the_reach_of_the_benchmark_is_a_metre_each_way_and_a_radian():
    setup = reach("uky").vehicles["sat1"]
    assert math.dist(setup.start[:2], setup.goal[:2]) == pytest.approx(math.sqrt(2.0))
    assert setup.goal[2] - setup.start[2] == 1.0


def test_drag_that_the_file_states_is_no_leaking_valve():
    """A vehicle with U. Kentucky's assumed drag was landed after 8 s: "jet 2 leaks"."""
    rig = make_twin(replace(reach("uky"), seed=1, duration_s=12.0))
    assert rig.experiment.vehicles["sat1"].model.drag > 0.0
    assert rig.fly(NullObserver()).fault is None


def test_the_shipped_vehicles_can_push_and_turn():
    for name in VEHICLES:
        model = reach(name).vehicles["sat1"].model
        assert weakest_force(model) > 0.3
        assert weakest_torque(model) > 0.04


@pytest.mark.parametrize("jets", [2, 3, 4, 8, 12])
@pytest.mark.parametrize("along_axes", [False, True])
def test_the_largest_torque_is_that_of_linear_programming(jets, along_axes):
    rng = np.random.default_rng(jets)
    for _ in range(40):
        angle = rng.uniform(-math.pi, math.pi, jets)
        if along_axes:  # many parallel pushes
            angle = 0.5 * math.pi * (np.arange(jets) % 4)
        push = rng.uniform(0.1, 1.0, jets) * (np.cos(angle), np.sin(angle))
        turn = rng.uniform(-0.2, 0.2, jets)
        best = linprog(-turn, A_eq=push, b_eq=(0.0, 0.0), bounds=(0.0, 1.0))
        assert most_torque(push, turn) == pytest.approx(-best.fun, abs=1e-9)
