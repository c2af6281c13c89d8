"""Periods of valve commands start when the commands change, whatever the log's clock says."""

import numpy as np
import pytest

from testbed.identification.command_periods import periods

PERIOD = 0.1


def logged(phase, rate, begin, seconds=30.0, late=0.0):
    """Rows and random duties of 2 jets; periods start at `phase` [s], the log at `begin` [s]."""
    rng = np.random.default_rng(0)
    duty = np.repeat(rng.random((round(seconds / PERIOD) // 3 + 2, 2)), 3, axis=0)
    t = begin + late + np.arange(0.0, seconds, 1.0 / rate)
    return t, duty[np.floor((t - begin - phase) / PERIOD + 1e-6).astype(int) + 1]


@pytest.mark.parametrize("begin", [0.0, 1.79e9, 1.79e9 + 0.0437])
@pytest.mark.parametrize("phase", [0.0, 0.008, 0.05, 0.093])
@pytest.mark.parametrize("rate", [59.94, 101.3])
def test_the_phase_is_that_of_the_changes(begin, phase, rate):
    t, share = logged(phase, rate, begin)
    start, taken, notes = periods(t, share, PERIOD, None)
    assert notes == []
    off = (start[1:-1] - begin - phase + 0.5 * PERIOD) % PERIOD - 0.5 * PERIOD
    assert np.abs(off).max() < 1.5e-3
    assert abs(taken.sum() - 300) <= 3
    assert np.diff(start[1:]).min() > 0.9 * PERIOD


def test_rows_on_the_periods_keep_their_times():
    t, share = logged(0.0, 20.0, 0.0)
    start, taken, _ = periods(t, share, PERIOD, None)
    np.testing.assert_allclose(start, t[::2], atol=1e-9)
    assert taken[::2].all()


def test_a_phase_that_cannot_be_told_is_said_and_can_be_given():
    t, share = logged(0.03, 60.0, 0.0)
    share[:] = share[0]
    assert any("phase_s" in note for note in periods(t, share, PERIOD, None)[2])
    start, _, notes = periods(t, share, PERIOD, 0.03)
    assert notes == []
    off = (start[1:] - 0.03 + 0.5 * PERIOD) % PERIOD - 0.5 * PERIOD
    assert np.abs(off).max() < 1e-9


def test_commands_that_change_in_every_row_tell_no_phase():
    t, _ = logged(0.0, 60.0, 0.0)
    share = np.random.default_rng(1).random((len(t), 2))
    assert periods(t, share, PERIOD, None)[2]
