"""A run folder is calibrated from what the cameras saw, not from what the vehicle made of it."""

import numpy as np
import pytest

import testbed
from testbed.config import SHIPPED, load
from testbed.identification.motion import calibrate_motion, interval
from testbed.identification.own_run import read_run_log
from testbed.identification.suspicion import look_at, suspicions
from testbed.logs.history import gather
from testbed.logs.log_reader import LogReader
from testbed.rig.twin import make_twin

NOISE = 0.0005  # [m]
SLOW = ["valve.open_delay_s=0.02", "valve.close_delay_s=0.02", "valve.min_off_s=0.03"]
LIGHT = [f"vehicles.*.model.{word}" for word in ["mass=4.0", "inertia=0.05", *SLOW]]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A square of a light vehicle, in pulses that are shorter than the check's grid."""
    words = [*LIGHT, f"table.mocap.noise={NOISE}", "table.mocap.noise_deg=0.1", "criteria={}"]
    experiment = load(SHIPPED / "scenarios" / "square.toml", [*words, "seed=2"])
    return testbed.fly(experiment, log=tmp_path_factory.mktemp("square") / "run")


@pytest.fixture(scope="module")
def log(run):
    return read_run_log(run.folder, None)


def test_poses_are_those_of_the_cameras(run, log):
    flown = gather(LogReader(run.folder / "log.mcap"))
    true = flown.vehicles["sat1"].true
    error = log.pose[:, :2] - [
        [np.interp(t, flown.true_t, true[:, axis]) for axis in (0, 1)] for t in log.t
    ]
    assert np.diff(log.t).min() > 0.0
    assert len(log.t) > 0.97 * 100.0 * 160.0
    assert error.std() == pytest.approx(NOISE, rel=0.03)
    follows = np.corrcoef(error[1:, 0], error[:-1, 0])[0, 1]
    assert abs(follows) < 0.05  # an estimate's error goes on from pose to pose


def test_short_pulses_explain_the_motion(run, log):
    look = look_at([log], run.experiment.vehicles["sat1"].model)
    assert look.plain > 0.4
    assert 0.5 < look.scale < 1.5


@pytest.fixture(scope="module")
def held(tmp_path_factory):
    """A vehicle that holds its place: jets and slope cancel, and the path tells little."""
    run = testbed.fly(testbed.load("hold"), log=tmp_path_factory.mktemp("hold") / "run")
    return run.experiment.vehicles["sat1"].model, read_run_log(run.folder, None)


def test_a_vehicle_that_holds_its_place_is_warned_of_and_not_refused(held):
    vehicle, log = held
    assert look_at([log], vehicle).plain < 0.04
    found = list(suspicions([log], vehicle))
    assert [(one.name, one.refuses) for one in found] == [("little-motion", False)]


@pytest.mark.parametrize(
    "change", [lambda p: np.roll(p, 3000, axis=0), lambda p: p * [1, 1, -1], lambda p: p[::-1]]
)
def test_commands_of_another_time_are_refused_there_too(held, change):
    vehicle, log = held
    found = list(suspicions([log._replace(pose=change(log.pose))], vehicle))
    assert any(one.refuses for one in found)


def test_the_true_numbers_are_in_the_intervals(run, log):
    vehicle = run.experiment.vehicles["sat1"].model
    flown = make_twin(run.experiment).twin.plant.parameters
    found = calibrate_motion([log], vehicle)
    inertia = flown.inertia[0] / vehicle.inertia * vehicle.mass / flown.mass[0]
    for name, true in (("inertia", inertia), ("delay", flown.timing[0, 0])):
        low, high = interval(found, found.model.index(name))
        assert low < true < high
    assert found.estimate.p[found.model.index("inertia")] == pytest.approx(inertia, rel=0.02)
