"""The bounded potential: its formula, its ends, and its slope against differences."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.bounded_potential import BoundedPotential, bounded_potential

PAPER = BoundedPotential(near=14.0, far=36.0, height=1e4)  # xue2022 with margins of 4 m
TABLE = BoundedPotential(near=0.7, far=1.8, height=0.2)


def eq_7(u, x, d):
    weight = (d - u.near) ** 2 * (u.far - x) / u.height
    return (x - d) ** 2 * (u.far - x) / (x - u.near + weight)


def eq_8(u, x, d):
    weight = (x - u.near) * (u.far - d) ** 2 / u.height
    return (x - u.near) * (x - d) ** 2 / (u.far - x + weight)


@pytest.mark.parametrize("u", [PAPER, TABLE])
@given(share=st.floats(0.0, 1.0), at=st.floats(0.1, 0.9))
def test_value_is_the_papers(u, share, at):
    x, d = (u.near + s * (u.far - u.near) for s in (share, at))
    expected = eq_7(u, x, d) if x <= d else eq_8(u, x, d)
    assert bounded_potential(u, x, d)[0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("u", [PAPER, TABLE])
@given(share=st.floats(-0.3, 1.3), at=st.floats(0.1, 0.9))
def test_slope_is_the_difference(u, share, at):
    x, d = (u.near + s * (u.far - u.near) for s in (share, at))
    h = 1e-6 * u.far
    ends = np.array([u.near, d, u.far])
    if np.abs(ends - x).min() < 2.0 * h:
        return  # a kink inside the difference
    ahead, behind = (bounded_potential(u, x + s, d)[0] for s in (h, -h))
    slope = bounded_potential(u, x, d)[1]
    # a very high, very narrow wall at the end: its third derivative is what limits the difference
    assert slope == pytest.approx((ahead - behind) / (2.0 * h), rel=1e-4, abs=1e-6 * u.far)


@pytest.mark.parametrize("u", [PAPER, TABLE])
@pytest.mark.parametrize("at", [0.2, 0.5, 0.8])
def test_as_high_as_q_at_both_ends_and_flat_at_the_desired_distance(u, at):
    d = u.near + at * (u.far - u.near)
    assert bounded_potential(u, u.near, d)[0] == pytest.approx(u.height)
    assert bounded_potential(u, u.far, d)[0] == pytest.approx(u.height)
    assert bounded_potential(u, d, d) == (0.0, 0.0)


@pytest.mark.parametrize("u", [PAPER, TABLE])
@given(share=st.floats(-0.5, 1.5), at=st.floats(0.1, 0.9))
def test_only_one_minimum(u, share, at):
    x, d = (u.near + s * (u.far - u.near) for s in (share, at))
    value, slope = bounded_potential(u, x, d)
    assert value >= 0.0
    assert slope * (x - d) >= 0.0


@pytest.mark.parametrize("u", [PAPER, TABLE])
def test_stiffness_differs_between_the_sides_as_said(u):
    d = u.near + 0.7 * (u.far - u.near)
    a, b, h = u.far - d, d - u.near, 1e-7 * u.far
    stiff = bounded_potential(u, d + h, d)[1] / h
    soft = -bounded_potential(u, d - h, d)[1] / h
    assert stiff == pytest.approx(2.0 * b / (a + b * a**2 / u.height), rel=1e-4)
    assert soft == pytest.approx(2.0 * a / (b + b**2 * a / u.height), rel=1e-4)


def test_beyond_the_ends_it_goes_on_with_the_slope_of_the_end():
    for end, out in ((PAPER.near, -3.0), (PAPER.far, 4.0)):
        value, slope = bounded_potential(PAPER, end, 30.0)
        beyond, same = bounded_potential(PAPER, end + out, 30.0)
        assert same == slope
        assert beyond == pytest.approx(value + slope * out)
        assert beyond > value


def test_a_pair_that_belongs_beyond_the_end_is_only_repelled():
    d = 50.0  # pair 1-3 of xue2022
    assert bounded_potential(PAPER, 30.0, d)[1] < 0.0
    value, slope = bounded_potential(PAPER, PAPER.far, d)
    assert value == 0.0
    assert slope < 0.0  # the force jumps at the end, the energy does not
    assert bounded_potential(PAPER, PAPER.far + 1.0, d) == (0.0, 0.0)
