"""A body that is seen elsewhere was pushed, or the frame moved; a frozen one does not fool."""

import math

import numpy as np
import pytest

from stages import Estimator
from testbed.core.types import PoseSample
from testbed.flight.detectors import what_stepped
from testbed.flight.estimator import EstimatorParams

FRAME = 0.01  # [s]
AT = 1.0  # of the event [s]


def seen(mocap, path, until, seed=0):
    """Noisy poses of a body at path(t) = x, y, theta."""
    rng = np.random.default_rng(seed)
    sigma = mocap.noise, mocap.noise, math.radians(mocap.noise_deg)
    times = np.arange(0.0, until, FRAME)
    return [PoseSample(t, *(path(t) + sigma * rng.standard_normal(3)).tolist()) for t in times]


def absorbed(vehicle, table, samples):
    """The estimator after these poses, and the steps that it noted."""
    estimator, steps = Estimator(EstimatorParams(), vehicle, table.mocap), []
    for sample in samples:
        estimator.update([sample], sample.captured_at)
        if estimator.m.step.any():
            steps.append((estimator.m.step.copy(), estimator.m.going.copy()))
    return estimator, steps


@pytest.mark.parametrize(
    "step", [(0.006, 0.0, 0.0), (0.0, -0.03, 0.0), (0.02, 0.02, 0.015), (0.0, 0.0, 0.05)]
)
def test_a_frame_that_moves_is_a_step_and_leaves_the_velocity(vehicle, table, step):
    def path(t):
        return np.array([0.1 * t, 0.0, 0.0]) + (t >= AT) * np.array(step)

    estimator, steps = absorbed(vehicle, table, seen(table.mocap, path, 1.2))
    ((found, going),) = steps
    assert found == pytest.approx(step, abs=0.0015)
    assert going == pytest.approx([0.1, 0.0, 0.0], abs=0.005)
    assert estimator.m.x[3:5] == pytest.approx([0.1, 0.0], abs=0.005)


@pytest.mark.parametrize("push", [(0.05, 0.0, 0.0), (-0.2, 0.1, 0.0), (0.0, 0.0, 0.5)])
def test_a_push_is_no_step(vehicle, table, push):
    def path(t):
        return np.array([0.1 * t, 0.0, 0.0]) + max(0.0, t - AT) * np.array(push)

    estimator, steps = absorbed(vehicle, table, seen(table.mocap, path, 1.6))
    assert steps == []
    assert estimator.m.x[3:6] == pytest.approx([0.1 + push[0], push[1], push[2]], abs=0.03)


@pytest.mark.parametrize("pull", [0.05, 0.2])
def test_a_growing_deviation_is_no_step(vehicle, table, pull):
    def path(t):
        grown = 0.5 * pull * max(0.0, t - AT) ** 2
        return np.array([0.1 * t + grown, 0.0, 20.0 * grown])

    assert absorbed(vehicle, table, seen(table.mocap, path, 2.5))[1] == []


@pytest.mark.parametrize("dither", [1e-9, 2e-6, 2e-5])
def test_a_frozen_pose_with_a_little_noise_does_not_stop_the_estimate(vehicle, table, dither):
    samples = seen(table.mocap, lambda t: np.array([0.05 * t, 0.0, 0.0]), AT)
    last, rng = samples[-1], np.random.default_rng(1)
    for k in range(10):
        x, y = (np.array([last.x, last.y]) + dither * rng.standard_normal(2)).tolist()
        samples.append(PoseSample(AT + k * FRAME, x, y, last.theta))
    estimator, steps = absorbed(vehicle, table, samples)
    assert steps == []
    assert estimator.m.still >= 9
    assert estimator.m.x[3] == pytest.approx(0.05, abs=0.01)


def test_ordinary_noise_is_hardly_ever_still(vehicle, table):
    estimator = Estimator(EstimatorParams(), vehicle, table.mocap)
    longest = 0
    for sample in seen(table.mocap, lambda t: np.zeros(3), 60.0):
        estimator.update([sample], sample.captured_at)
        longest = max(longest, estimator.m.still)
    assert longest <= 5  # a frozen pose is reported from 8 on


@pytest.mark.parametrize(
    ("step", "found"),
    [
        ((-0.03, 0.0, 0.0), (0.3, 0.0, 0.0)),  # straight back: 0.3 s late
        ((0.03, 0.0, 0.0), (0.0, 0.03, 0.0)),
        ((0.0, 0.03, 0.0), (0.0, 0.03, 0.0)),
        ((-0.03, 0.0, 0.05), (0.0, 0.03, 0.0)),  # a delay would not turn it
        ((0.0, 0.0, 0.05), (0.0, 0.0, 0.05)),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    ],
)
def test_a_step_back_along_the_motion_may_be_a_delay(step, found):
    assert what_stepped(np.array(step), np.array([0.1, 0.0, 0.0])) == pytest.approx(found)
