"""Derivatives of a moving goal against differences of where it is."""

import numpy as np
import pytest

from testbed.core.path import Circle, Line, Points, Square, along, heading_at

PATHS = [
    Line((0.02, -0.01)),
    Circle(radius=0.8, period_s=90.0, start_deg=30.0),
    Square(side=0.7, period_s=120.0, start_deg=20.0),
    Points(points=[(0.3, 0.1), (0.5, 0.6), (0.1, 0.9)], speed=0.03),
    Points(points=[(0.3, 0.1), (0.5, 0.6), (0.1, 0.9)], speed=0.03, ramp_s=20.0),
]


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


def test_a_square_has_its_corners_at_rest_and_comes_round():
    square = Square(side=2.0, period_s=80.0)
    corners = [(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0), (0.0, 0.0), (2.0, 0.0)]
    for k, corner in enumerate(corners):
        moved = square.at(20.0 * k)
        assert moved.p == pytest.approx(corner, abs=1e-12)
        assert moved.v == pytest.approx((0.0, 0.0), abs=1e-12)
        assert moved.a == pytest.approx((0.0, 0.0), abs=1e-12)


@pytest.mark.parametrize("t", np.linspace(0.1, 159.9, 17))
def test_a_square_is_walked_along_its_sides(t):
    x, y = Square(side=2.0, period_s=80.0).at(t).p
    assert min(abs(x), abs(x - 2.0), abs(y), abs(y - 2.0)) == pytest.approx(0.0, abs=1e-12)


def test_a_curve_passes_its_points_and_rests_at_the_last():
    points = [(0.3, 0.1), (0.5, 0.6), (0.5, 0.6), (0.1, 0.9)]
    curve = Points(points=points, speed=0.05, start_s=10.0)
    way = np.array([curve.at(t).p for t in np.arange(0.0, 100.0, 0.05)])
    for point in points:
        assert np.hypot(*(way - point).T).min() < 2e-3
    speeds = [np.hypot(*curve.at(t).v) for t in np.arange(0.0, 100.0, 0.1)]
    assert max(speeds) == pytest.approx(0.05, rel=0.1)
    assert curve.at(10.0).p == (0.0, 0.0)
    assert curve.at(100.0).p == pytest.approx(points[-1])
    assert curve.at(100.0).v == curve.at(5.0).v == (0.0, 0.0)


def test_points_on_top_of_each_other_are_no_curve():
    assert Points(points=[(0.0, 0.0)], speed=0.1).at(3.0).p == pytest.approx((0.0, 0.0), abs=1e-8)


def test_with_a_ramp_the_speed_is_even_between():
    curve = Points(points=[(2.0, 0.0)], speed=0.1, start_s=5.0, ramp_s=4.0)
    assert curve.at(7.0).v == pytest.approx((0.05, 0.0))
    for t in (9.0, 15.0, 25.0):
        assert curve.at(t).v == pytest.approx((0.1, 0.0))
        assert curve.at(t).a == pytest.approx((0.0, 0.0), abs=1e-12)
    assert curve.at(15.0).p == pytest.approx((0.8, 0.0))
    assert curve.at(29.0).p == pytest.approx((2.0, 0.0))
    assert curve.at(40.0).p == pytest.approx((2.0, 0.0))
    assert curve.at(40.0).v == (0.0, 0.0)


def test_a_ramp_longer_than_the_way_is_cut():
    curve = Points(points=[(0.2, 0.0)], speed=0.1, ramp_s=60.0)
    assert curve.at(4.0).p == pytest.approx((0.2, 0.0))


LED = [
    Circle(radius=0.8, period_s=90.0, start_deg=30.0, heading="along"),
    Points(points=[(0.3, 0.1), (0.5, 0.6), (0.1, 0.9)], speed=0.03, heading="along"),
    Points(points=[(0.3, 0.1), (0.5, 0.6)], speed=0.03, ramp_s=9.0, start_s=4.0, heading="along"),
]


@pytest.mark.parametrize("path", LED)
@pytest.mark.parametrize("t", [6.0, 14.0, 17.0])
def test_a_heading_along_a_path_is_the_direction_of_its_velocity(path, t):
    vx, vy = path.at(t).v
    theta = heading_at(path, 9.0, t)
    assert (np.cos(theta), np.sin(theta)) == pytest.approx(np.array([vx, vy]) / np.hypot(vx, vy))


@pytest.mark.parametrize("path", LED)
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("t", [6.0, 17.0])
def test_turn_rate_and_its_derivative_are_rates(path, order, t):
    h = 1e-3
    before, after = (path.tangent(t + side)[order - 1] for side in (-h, h))
    assert path.tangent(t)[order] == pytest.approx((after - before) / (2.0 * h), abs=1e-6)


def test_at_rest_the_heading_is_that_of_the_way_ahead():
    curve = Points(points=[(0.0, 0.5), (0.5, 0.5)], speed=0.05, start_s=10.0, heading="along")
    first, last = curve.tangent(3.0), curve.tangent(1000.0)
    assert first == (pytest.approx(curve.tangent(10.1)[0], abs=1e-3), 0.0, 0.0)
    assert last[1:] == (0.0, 0.0)


@pytest.mark.parametrize("path", [None, *PATHS])
def test_without_the_word_the_heading_is_the_goals(path):
    assert along(path) is None
    assert heading_at(path, 0.7, 17.0) == 0.7
