"""The order of the body's step, measured: Gauss with three stages promises six."""

import numpy as np
import pytest

from sim_twin.body import C, new_stages, step
from sim_twin.ground import lay

SPAN = 1.6  # [s]
HOSE = np.array([0.3, -0.2, 0.05])
WARPED = {"uniform": (0.2, -0.1), "map": [[(-0.9, 0.5), (0.6, -0.7)], [(0.3, 0.8), (-0.4, 0.2)]]}


@pytest.fixture(scope="module")
def end_after(make_table):
    """The end of a turning, draggy flight over a warped table in steps of equal length."""
    ground = lay(make_table(tilt=WARPED))
    stages = new_stages()
    value, slope = np.array([3.0, -2.0, 0.3]), np.array([-1.5, 2.5, -0.4])

    def fly(steps):
        x, h = np.array([0.2, -0.1, 0.4, 0.3, -0.2, 3.0]), SPAN / steps
        for k in range(steps):
            points = (k + C[:, None]) * h
            body = np.tile([12.5, 0.2, 0.03, -0.05], (3, 1))
            stages.body[:] = np.hstack([value + points * slope, body])
            step(x, h, stages, 2.0, 0.05, HOSE, ground)
        return x

    return fly


def test_the_step_is_of_order_six(end_after):
    exact = end_after(64)
    errors = np.array([np.abs(end_after(steps) - exact).max() for steps in (4, 8, 16)])
    orders = np.log2(errors[:-1] / errors[1:])
    assert 5.8 < orders.min() <= orders.max() < 6.4
