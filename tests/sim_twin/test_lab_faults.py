"""Faults of a lab do to poses and vehicles what they say, from their time on."""

import math

import pytest

from sim_twin.fault_injection import FaultInjector
from testbed.core.fault_injection import Injection
from testbed.core.types import PoseSample

AT_REST = [[0.0] * 6]
TIMES = [0.01 * k for k in range(200)]
MOVING = [PoseSample(t, 0.1 * t, 0.5, 0.0) for t in TIMES]


@pytest.fixture
def plant(make_plant, make_vehicle):
    return make_plant([make_vehicle()], AT_REST)


def after(plant, kind, name="0", **more):
    """Poses after a fault that begins at 1 s, from then on."""
    broken = FaultInjector([Injection(kind, "0", at_s=1.0, **more)], plant, {}, (3.0, 3.0), seed=0)
    seen = broken.poses(name, MOVING)
    assert [s for s in seen if s.captured_at < 1.0] == MOVING[:100]
    return [s for s in seen if s.captured_at >= 1.0]


def test_late_poses_have_fresh_stamps(plant):
    late = after(plant, "delay_mocap", value=0.3)
    stamps = [s.captured_at for s in late]
    assert len(stamps) > 90  # rounding may show a pose twice; the second is left out
    assert set(stamps) <= set(TIMES[100:])
    assert [s.x for s in late] == pytest.approx([0.1 * (t - 0.3) for t in stamps], abs=0.0011)


def test_slow_cameras(plant):
    assert len(after(plant, "slow_mocap", value=4.0)) == 4


def test_a_frozen_pose_may_have_noise(plant):
    xs = {s.x for s in after(plant, "freeze_mocap", value=1e-5)}
    assert len(xs) == 100
    assert max(xs) - min(xs) < 1e-4
    assert len({s.x for s in after(plant, "freeze_mocap")}) == 1


def test_a_body_that_turns_does_so_alone(plant):
    turned = after(plant, "turn_body", value=5.0)
    assert [s.theta for s in turned] == pytest.approx([math.radians(5.0)] * 100)
    assert after(plant, "turn_body", "another", value=5.0) == MOVING[100:]


@pytest.mark.parametrize("name", ["0", "another"])
def test_a_frame_moves_with_all_bodies(plant, name):
    shifted = after(plant, "shift_frame", name, value=0.03, towards_deg=90.0)
    assert [s.y for s in shifted] == pytest.approx([0.53] * 100)
    crept = after(plant, "creep_frame", name, value=0.02)
    assert crept[50].x == pytest.approx(0.15 + 0.01)
    turned = after(plant, "turn_frame", name, value=90.0)
    assert (turned[0].x, turned[0].y) == pytest.approx((-0.5, 0.1))


@pytest.mark.parametrize(
    ("kind", "value", "field", "factor"),
    [("mass", 1.5, "mass", 1.5), ("thrust", 0.5, "thrust", 0.5), ("regulator", 2.0, "thrust", 2.0)],
)
def test_what_the_file_does_not_know_comes_and_goes(plant, kind, value, field, factor):
    what = Injection(kind, "0", at_s=0.2, for_s=0.2, value=value)
    broken = FaultInjector([what], plant, {}, (3.0, 3.0), seed=0)
    usual, found = getattr(plant.parameters, field).copy(), []
    for k in range(6):
        broken.before(0.1 * (k + 1))
        found.append(float((getattr(plant.parameters, field) / usual).ravel()[0]))
        plant.advance(0.1 * (k + 1))
        broken.look(plant.t)
    assert found == pytest.approx([1.0, 1.0, factor, factor, 1.0, 1.0])


def test_a_hose_pulls_and_pads_drag(plant):
    hose = Injection("hose", "0", at_s=0.0, value=0.2, towards_deg=90.0)
    broken = FaultInjector([hose], plant, {}, (3.0, 3.0), seed=0)
    broken.before(1.0)
    plant.advance(1.0)
    assert plant.x[0, 4] == pytest.approx(0.2 / 12.5, rel=1e-3)
    assert plant.x[0, 3] == pytest.approx(0.0, abs=1e-9)
    drag = Injection("pad_drag", "0", at_s=0.0, value=2.0)
    FaultInjector([drag], plant, {}, (3.0, 3.0), seed=0).before(1.1)
    assert plant.parameters.drag[0] == 2.0
