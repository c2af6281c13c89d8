"""Poses of one vehicle from frames of a motion-capture system, and why none arrive."""

import numpy as np
import pytest

from testbed.core.lab import MocapWire
from testbed.core.types import Pose
from testbed.mocap.exposure import Axes, Exposure
from testbed.mocap.poses import LATE_S, MocapPoses, PoseTrouble
from testbed.realtime.clock_sync import ClockOffset
from testbed.realtime.wall_clock import WallClock


def noisy(seed=1):
    rng = np.random.default_rng(seed)
    return lambda x, y: Pose(*(np.array([x, y, 0.0]) + 1e-4 * rng.standard_normal(3)).tolist())


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
    poses = MocapPoses(Recorded(exposures), wire, WallClock(10**9), "sat1")
    samples = poses.samples()
    poses.review()
    assert [s.captured_at for s in samples] == pytest.approx([0.0, 0.01, 0.02, 0.03])
    assert [(s.x, s.y, s.theta) for s in samples] == [
        pytest.approx((p.x, p.y, p.theta)) for p in truth
    ]
    assert list(poses.latencies) == pytest.approx([0.02] * 4)
    assert poses.lost_frames == 2
    assert poses.trouble == PoseTrouble.SILENT  # the present is long after these frames


def test_the_newest_poses_of_reference_bodies_come_once_and_in_the_frame_of_the_table():
    wire = MocapWire(
        origin=(1.0, 1.0), bodies={"north": "Post 1"}, reference={"north": (0.0, 2.9, 0.0)}
    )
    axes = Axes(wire)
    exposures = [
        Exposure(n, n * 10**7, n * 10**7, {"Post 1": axes.to_cameras(Pose(0.001 * n, 2.9, 0.0))})
        for n in (1, 2)
    ]
    poses = MocapPoses(Recorded(exposures), wire, WallClock(0), "sat1")
    assert poses.samples() == []  # of the vehicle
    (seen,) = poses.reference_bodies().items()
    assert seen[0] == "north"
    assert (seen[1].captured_at, seen[1].x, seen[1].y) == pytest.approx((0.02, 0.002, 2.9))
    assert poses.reference_bodies() == {}


def test_the_quickest_exchange_tells_the_clock():
    clock = ClockOffset()
    clock.received(1_000_000, 400)
    assert clock.best.delay_ns == -1
    clock.exchanged(100, 5_200, 400)  # 250 is the middle
    clock.exchanged(1_000, 6_100, 1_100)
    assert clock.best.offset_ns == 5_050
    assert clock.to_own(10_050) == 5_000
    clock.exchanged(10, 0, 5)  # it came before it was asked
    assert clock.best.offset_ns == 5_050


class Clock:
    now = 0.0

    def of(self, ns):
        return 1e-9 * ns


def test_why_no_poses_arrive():
    wire, clock, source = MocapWire(up="z"), Clock(), Recorded([])
    here, axes = Pose(0.0, 0.0, 0.0), Axes(wire)
    poses = MocapPoses(source, wire, clock, "sat1")

    def at(t, *bodies):
        clock.now, ns = t, round(1e9 * t)
        if bodies:
            seen = {name: axes.to_cameras(here) for name in bodies}
            source.exposures = [Exposure(round(100 * t), ns, ns, seen)]
        poses.samples()
        poses.review()
        return poses.trouble

    assert at(0.0) is None  # nothing was ever heard: the cameras may start later
    assert at(0.1, "sat2") is PoseTrouble.STALE
    assert at(0.2, "sat1", "sat2") is None
    assert at(0.19 + LATE_S, "sat2") is None
    assert at(0.21 + LATE_S, "sat2") is PoseTrouble.STALE
    assert at(0.4) is PoseTrouble.STALE  # once for as long as it lasts
    assert at(0.6) is PoseTrouble.SILENT
    assert at(0.7, "sat1") is None
    assert poses.troubles == {PoseTrouble.STALE: 2, PoseTrouble.SILENT: 1}
