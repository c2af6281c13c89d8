"""Derivatives of a moving goal against differences of where it is."""

import numpy as np
import pytest

from testbed.core.path import Circle, Line

PATHS = [Line((0.02, -0.01)), Circle(radius=0.8, period_s=90.0, start_deg=30.0)]


@pytest.mark.parametrize("path", PATHS)
def test_a_path_starts_where_the_experiment_puts_the_goal(path):
    assert path.at(0.0).p == (0.0, 0.0)


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("order", [1, 2, 3])
def test_each_derivative_is_the_rate_of_the_one_before(path, order):
    t, h = 17.0, 1e-3
    before, after = (np.array(path.at(t + side)[order - 1]) for side in (-h, h))
    assert path.at(t)[order] == pytest.approx((after - before) / (2.0 * h), abs=1e-8)


def test_a_circle_comes_round():
    assert Circle(0.5, 60.0).at(60.0).p == pytest.approx((0.0, 0.0), abs=1e-12)
    assert Circle(0.5, 60.0).at(30.0).p == pytest.approx((-1.0, 0.0))
