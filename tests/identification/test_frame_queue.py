"""Poses read from a queue of frames get the times of their frames."""

import numpy as np
import pytest

from testbed.identification.frame_queue import frame_times, jumps

STEP, FRAME, MOST = 0.125, 0.1, 3


def read(seconds, speed, noise=0.0):
    """Rows, the true times of their frames, and the path of a circle."""
    rng = np.random.default_rng(1)
    t = np.arange(0.0, seconds, STEP)
    age, made = 0.0, []
    for now in t:
        made.append(now - age)
        age += STEP - FRAME
        if age > MOST * FRAME - 1e-9:
            age -= MOST * FRAME
    made = np.array(made)
    angle = speed / 0.3 * made
    path = 0.3 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return t, made, path + noise * rng.standard_normal(path.shape)


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_the_times_of_the_frames_are_found(noise):
    t, made, path = read(60.0, 0.033, noise)
    off = frame_times(t, path, FRAME, MOST) - made
    assert np.ptp(off) < 1e-6


def test_at_rest_the_times_increase_and_stay_near_those_of_the_rows():
    t, _, path = read(30.0, 0.0, 1e-3)
    found = frame_times(t, path, FRAME, MOST)
    assert np.all(np.diff(found) > 0.0)
    assert np.ptp(t - found) < 2.0 * MOST * FRAME


def test_a_log_without_a_queue_keeps_its_times():
    t, _, path = read(30.0, 0.03)
    np.testing.assert_array_equal(frame_times(t, path, STEP, MOST), t)
    np.testing.assert_array_equal(frame_times(t[:5], path[:5], FRAME, MOST), t[:5])


def test_jumps_are_evenly_spaced():
    _, _, path = read(60.0, 0.033, 1e-3)
    assert set(np.diff(jumps(path, MOST, 12.0))) == {12}
