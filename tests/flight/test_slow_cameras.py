"""Cameras with few frames or late poses: faults are still named, and healthy vehicles are not."""

import numpy as np
import pytest

from testbed.config import find, load
from testbed.flight.estimator import EstimatorParams
from testbed.flight.jet_faults import known_of
from testbed.rig.twin import make_twin
from testbed.run.drill import Notes

SLOW = [
    ("table.mocap.rate_hz=10", "table.mocap.latency_s=0.03"),
    ("table.mocap.latency_s=0.12",),
    ("table.mocap.rate_hz=10", "table.mocap.latency_s=0.03", "flight.jet_period_s=0.04"),
]


def flown(*overrides):
    experiment = load(find("hold"), ["duration_s=20", *overrides])
    notes = Notes()
    return make_twin(experiment).fly(notes), notes


@pytest.mark.parametrize("cameras", SLOW)
def test_a_valve_that_sticks_open_is_named(cameras):
    inject = 'inject=[{kind="stick_open",vehicle="sat1",at_s=6.0,jet=3}]'
    ending, _ = flown(*cameras, inject)
    assert ending.fault is not None
    assert ending.fault.origin.id == "valve_stuck_open"
    assert "jet 3 " in ending.fault.words
    assert ending.t < 8.5


@pytest.mark.parametrize("cameras", SLOW)
def test_a_healthy_vehicle_is_not(cameras):
    ending, notes = flown(*cameras)
    assert ending.fault is None
    assert {row for _, _, row in notes.rows} <= {"pose_stale", "link_late"}


@pytest.mark.parametrize(
    ("rate", "period", "ticks"), [(100, 0.1, 1), (10, 0.1, 1), (10, 0.04, 3), (12, 0.07, 2)]
)
def test_a_look_is_no_shorter_than_a_frame(vehicle, rate, period, ticks):
    table = load(find("hold"), [f"table.mocap.rate_hz={rate}"]).table
    known = known_of(vehicle, period, EstimatorParams(), table)
    assert known.ticks == ticks
    assert np.isclose(known.period, ticks * period)


def test_fast_cameras_may_lose_several_frames_and_slow_ones_one(vehicle, table):
    assert known_of(vehicle, 0.1, EstimatorParams(), table).trusted_age == 0.1
    slow = load(find("hold"), [*SLOW[0]]).table
    age = known_of(vehicle, 0.1, EstimatorParams(), slow).trusted_age
    assert age == pytest.approx(0.03 + 2 * 0.1 + 8 * 0.001)
