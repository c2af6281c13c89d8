"""What a motion-capture system does wrong, told apart."""

import math

import numpy as np
import pytest

from testbed.core.lab import MocapWire
from testbed.core.types import Pose
from testbed.mocap.body_monitor import BodyMonitor, Trouble
from testbed.mocap.exposure import Axes, Exposure
from testbed.mocap.poses import MocapPoses
from testbed.realtime.clock_sync import ClockOffset
from testbed.realtime.wall_clock import WallClock

HZ = 100.0


def noisy(seed=1):
    rng = np.random.default_rng(seed)
    return lambda x, y: Pose(*(np.array([x, y, 0.0]) + 1e-4 * rng.standard_normal(3)).tolist())


@pytest.fixture
def watch():
    watch = BodyMonitor()
    near = noisy()
    for k in range(20):
        watch.look(k / HZ, {"a": near(0.0, 0.0), "b": near(1.0, 0.0)})
    assert watch.troubles == {}
    return watch


def test_a_healthy_body_is_believed():
    watch, near = BodyMonitor(), noisy()
    for k in range(500):
        t = k / HZ
        poses = {"a": near(0.5 * t, 0.0), "b": near(0.0, math.sin(t))}
        assert watch.look(t, poses) == poses
    assert watch.counts == {}


def test_no_frames_are_silence(watch):
    watch.pass_time(0.25)
    assert watch.troubles == {}
    watch.pass_time(0.35)
    assert watch.troubles == {"a": Trouble.SILENT, "b": Trouble.SILENT}
    watch.look(0.36, {"a": noisy(2)(0, 0), "b": noisy(3)(1, 0)})
    assert watch.troubles == {}


def test_an_untracked_body_is_stale_after_a_while(watch):
    near = noisy(4)
    for k in range(20, 40):
        assert set(watch.look(k / HZ, {"a": None, "b": near(1, 0)})) == {"b"}
        assert watch.troubles == ({"a": Trouble.STALE} if k > 29 else {})
    watch.look(0.4, {"a": near(0, 0), "b": near(1, 0)})
    assert watch.troubles == {}


def test_a_pose_that_stands_still_to_the_last_bit_is_frozen(watch):
    near, still = noisy(5), Pose(0.0, 0.0, 0.0)
    believed = []
    for k in range(20, 40):
        believed.append("a" in watch.look(k / HZ, {"a": still, "b": near(1, 0)}))
    assert believed == [True] * 5 + [False] * 15
    assert watch.troubles == {"a": Trouble.FROZEN}
    assert watch.counts == {Trouble.FROZEN: 1}


def test_a_jump_is_not_believed(watch):
    near = noisy(6)
    assert set(watch.look(0.2, {"a": near(0.5, 0.0), "b": near(1, 0)})) == {"b"}
    assert watch.troubles == {"a": Trouble.JUMPED}
    assert set(watch.look(0.21, {"a": near(0.0, 0.0), "b": near(1, 0)})) == {"a", "b"}
    assert watch.troubles == {}


def test_two_bodies_that_change_places_are_swapped(watch):
    near = noisy(7)
    assert watch.look(0.2, {"a": near(1, 0), "b": near(0, 0)}) == {}
    assert watch.troubles == {"a": Trouble.SWAPPED, "b": Trouble.SWAPPED}


def test_two_jumps_elsewhere_are_no_swap(watch):
    near = noisy(8)
    watch.look(0.2, {"a": near(2, 2), "b": near(-2, 2)})
    assert watch.troubles == {"a": Trouble.JUMPED, "b": Trouble.JUMPED}


def test_a_body_may_be_elsewhere_after_a_loss(watch):
    near = noisy(9)
    for k in range(20, 70):
        watch.look(k / HZ, {"a": None, "b": near(1, 0)})
    assert "a" in watch.look(0.7, {"a": near(0.5, 0), "b": near(1, 0)})


class Recorded:
    """A source that has been heard before."""

    def __init__(self, exposures):
        self.exposures = exposures

    def poll(self):
        exposures, self.exposures = self.exposures, []
        return exposures

    def close(self):
        pass


def test_poses_of_one_vehicle_in_the_frame_and_time_of_the_run():
    wire = MocapWire(up="y", origin=(1.0, 1.0), turn_deg=90.0, bodies={"sat1": "Rigid Body 4"})
    axes, near = Axes(wire), noisy(10)
    truth = [near(0.2, 0.1) for _ in range(4)]
    numbers = [5, 6, 9, 10]
    exposures = [
        Exposure(
            n, 10**9 + k * 10**7, 10**9 + k * 10**7 + 2 * 10**7,
            {"Rigid Body 4": axes.to_cameras(pose), "other": axes.to_cameras(Pose(k, 0, 0))},
        )
        for k, (n, pose) in enumerate(zip(numbers, truth, strict=True))
    ]  # fmt: skip
    poses = MocapPoses(Recorded(exposures), wire, WallClock(10**9), "sat1", BodyMonitor())
    samples = poses.samples()
    poses.review()
    assert [s.captured_at for s in samples] == pytest.approx([0.0, 0.01, 0.02, 0.03])
    assert [(s.x, s.y, s.theta) for s in samples] == [
        pytest.approx((p.x, p.y, p.theta)) for p in truth
    ]
    assert list(poses.latencies) == pytest.approx([0.02] * 4)
    assert poses.lost_frames == 2
    assert poses.trouble == Trouble.SILENT  # the present is long after these frames


def test_the_quickest_exchange_tells_the_clock():
    clock = ClockOffset()
    clock.heard(1_000_000, 400)
    assert clock.best.delay_ns == -1
    clock.exchanged(100, 5_200, 400)  # 250 is the middle
    clock.exchanged(1_000, 6_100, 1_100)
    assert clock.best.offset_ns == 5_050
    assert clock.to_own(10_050) == 5_000
    clock.exchanged(10, 0, 5)  # it came before it was asked
    assert clock.best.offset_ns == 5_050
