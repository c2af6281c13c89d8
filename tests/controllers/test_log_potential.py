"""The logarithmic potentials: slopes of Eq. (30), and values that are their primitives."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from controllers.log_potential import LogPotential, attraction, log_potential, repulsion, wish

PAPER = LogPotential(repel=0.2, attract=0.05, wish=0.2, safe=10.0, range=120.0, margin=0.1)
D = 60.0


def slope_of_eq_30(x, held):
    u = PAPER
    if x <= D:
        return u.repel * (x - D) / (x - u.safe)
    if held:
        return u.attract * (x - D) / (u.range - x)
    return u.wish * np.pi / (u.range - D) * np.sin(np.pi * (x - D) / (u.range - D))


@given(x=st.floats(10.2, 119.8), held=st.booleans())
def test_slope_is_eq_30(x, held):
    assert log_potential(PAPER, x, D, held)[1] == pytest.approx(slope_of_eq_30(x, held), rel=1e-12)


@given(x=st.floats(5.0, 130.0), held=st.booleans())
def test_value_is_the_integral_of_the_slope(x, held):
    kinks = [k for k in (10.1, D, 119.9, 120.0) if min(x, D) < k < max(x, D)]
    area, _ = quad(lambda s: log_potential(PAPER, s, D, held)[1], D, x, points=kinks or None)
    assert log_potential(PAPER, x, D, held)[0] == pytest.approx(area, rel=1e-7, abs=1e-9)


@pytest.mark.parametrize(("x", "edge", "held"), [(3.0, 10.1, True), (125.0, 119.9, True)])
def test_forces_stop_growing_a_margin_before_the_ends(x, edge, held):
    assert log_potential(PAPER, x, D, held)[1] == log_potential(PAPER, edge, D, held)[1]


def test_an_edge_that_began_short_is_held_all_the_same():
    # printed, Eq. (4) would give psi^d, which lets go at the range
    assert log_potential(PAPER, 119.0, D, True)[1] > 10.0 * log_potential(PAPER, 119.0, D, False)[1]


def test_a_pair_that_is_not_held_feels_nothing_out_of_range():
    assert wish(PAPER, 120.0, D) == pytest.approx((2.0 * PAPER.wish, 0.0), abs=1e-12)
    assert wish(PAPER, 500.0, D) == (2.0 * PAPER.wish, 0.0)


def test_an_obstacle_begins_at_its_distance():
    assert repulsion(PAPER, 40.0, 40.0, 10.0) == (0.0, 0.0)
    assert repulsion(PAPER, 39.0, 40.0, 10.0)[1] < 0.0
    assert attraction(PAPER, D, D) == (0.0, 0.0)
