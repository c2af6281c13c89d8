"""Fits of poses: how exact, with noise, drag and a clock that is off."""

import numpy as np
import pytest

from testbed.commission.motion import Noise, drift_of, kick_of, mean_of, noise_of, speed_of

NOISE = Noise(0.0002, np.radians(0.03))
RATE = 100.0


def poses(accel, change=(0.0, 0.0, 0.0), at=0.6, flow=0.2, drag=(0.0, 0.0), ends=2.5, seed=1):
    """A body from rest under a constant push, and one more push from `at` on, with noise."""
    fine = 1e-3
    t = np.arange(0.0, ends, fine)
    rows, rng = [t], np.random.default_rng(seed)
    for axis, c in enumerate((drag[0], drag[0], drag[1])):
        push = accel[axis] + np.where((t >= at) & (t < at + flow), change[axis] / flow, 0.0)
        v = np.zeros(len(t))
        for k in range(1, len(t)):
            v[k] = v[k - 1] + fine * (push[k - 1] - c * v[k - 1])
        rows.append(np.concatenate([[0.0], np.cumsum(fine * 0.5 * (v[1:] + v[:-1]))]))
    seen = np.array(rows).T[:: round(1.0 / RATE / fine)].copy()
    seen[:, 1:] += rng.standard_normal((len(seen), 3)) * NOISE.axes
    return seen


def test_noise_and_speed_of_a_body():
    still = poses((0.0, 0.0, 0.0))
    found = noise_of(still)
    assert found.place == pytest.approx(NOISE.place, rel=0.15)
    assert found.heading == pytest.approx(NOISE.heading, rel=0.2)
    rows = still + np.outer(still[:, 0], (0.0, 0.03, 0.04, 0.0))
    assert speed_of(rows) == pytest.approx(0.05, rel=0.02)


@pytest.mark.parametrize("drag", [(0.0, 0.0), (0.1, 0.9)])
def test_a_drift_is_found_within_its_error(drag):
    accel = np.array([0.008, -0.003, 0.02])
    found = drift_of(poses(accel, drag=drag), NOISE, drag)
    assert np.all(np.abs(found.accel - accel) < 4.0 * found.sigma)
    assert found.sigma[0] < 5e-4


@pytest.mark.parametrize(
    ("drag", "told"), [((0.0, 0.0), (0.0, 0.0)), ((0.1, 0.9), (0.1, 0.9)), ((0.2, 0.0), (0.0, 0.0))]
)
def test_a_push_is_found_with_its_delay_and_its_drag(drag, told):
    change = np.array([-0.009, 0.004, 0.05])
    rows = poses((0.005, 0.002, 0.0), change, at=0.65, drag=drag, ends=3.0)
    kick = kick_of(rows, 0.6, 0.2, NOISE, told)
    assert np.all(np.abs(kick.change - change) < 4.5 * kick.sigma + 0.01 * np.abs(change))
    assert kick.delay == pytest.approx(0.05, abs=4.0 * kick.delay_sigma + 0.003)
    assert kick.drag == pytest.approx(drag[0] - told[0], abs=4.0 * kick.drag_sigma)
    assert 0.8 < kick.misfit < 1.25


def test_a_clock_that_is_ahead_gives_a_negative_delay():
    rows = poses((0.0, 0.0, 0.0), (0.01, 0.0, 0.05), at=0.56)
    assert kick_of(rows, 0.6, 0.2, NOISE).delay == pytest.approx(-0.04, abs=0.015)


def test_repeated_pushes_are_averaged_in_the_frame_of_the_first():
    kicks = [kick_of(poses((0.0,) * 3, (0.01, 0.0, 0.05), seed=k), 0.6, 0.2, NOISE)
             for k in range(4)]  # fmt: skip
    turned = kicks[3]._replace(
        theta=kicks[3].theta + np.pi / 2,
        change=np.array([-kicks[3].change[1], kicks[3].change[0], kicks[3].change[2]]),
    )
    mean = mean_of([*kicks[:3], turned])
    assert mean.change == pytest.approx(np.mean([k.change for k in kicks], axis=0), abs=1e-5)
    assert mean.sigma == pytest.approx(0.5 * kicks[0].sigma, rel=0.05)
