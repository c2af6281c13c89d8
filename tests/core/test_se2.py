"""Angles and the turn between W and B, against complex numbers."""

import cmath
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from testbed.core.se2 import to_body, to_table, velocity_at, wrap, wrap_all, wrap_compiled

angles = st.floats(-1e4, 1e4)
lengths = st.floats(-1e3, 1e3)


@given(angles)
def test_wrap_turns_to_the_same_direction(angle):
    assert cmath.rect(1.0, wrap(angle)) == pytest.approx(cmath.rect(1.0, angle), abs=1e-11)


@given(angles)
def test_wrap_stays_within_half_a_turn(angle):
    assert -math.pi <= wrap(angle) <= math.pi


@pytest.mark.parametrize(
    ("angle", "wrapped"),
    [
        (0.0, 0.0),
        (1.0, 1.0),
        (-math.pi, -math.pi),
        (math.pi, -math.pi),
        (3.0 * math.pi, -math.pi),
        (math.pi - 1e-9, math.pi - 1e-9),
        (math.pi + 1e-9, -math.pi + 1e-9),
        (-math.pi - 1e-9, math.pi - 1e-9),
        (-4.0, -4.0 + 2.0 * math.pi),
    ],
)
def test_wrap_at_the_ends_of_its_range(angle, wrapped):
    assert wrap(angle) == pytest.approx(wrapped, abs=1e-15)


def test_all_at_once_is_one_after_the_other():
    rng = np.random.default_rng(3)
    ends = [k * math.pi + e for k in range(-5, 6) for e in (-1e-16, 0.0, 1e-16, 4e-16)]
    angles = np.concatenate((rng.uniform(-20.0, 20.0, 2000), ends, [math.nextafter(-math.pi, -4)]))
    one_by_one = np.array([wrap(angle) for angle in angles.tolist()])
    assert wrap_all(angles).tobytes() == one_by_one.tobytes()


def test_wrap_never_gives_pi():
    assert wrap(math.nextafter(-math.pi, -4.0)) < math.pi


@given(st.floats(-1.0, 1.0), st.integers(-1000, 1000))
def test_wrap_does_not_count_whole_turns(angle, turns):
    assert wrap(angle + turns * 2.0 * math.pi) == pytest.approx(angle, abs=1e-11)


@given(st.one_of(angles, st.just(math.pi), st.just(-math.pi)))
def test_compiled_wrap_gives_the_same_bits(angle):
    assert wrap_compiled(angle) == wrap(angle)


@given(angles, lengths, lengths)
def test_to_table_multiplies_by_the_heading(theta, x, y):
    expected = complex(x, y) * cmath.rect(1.0, theta)
    assert complex(*to_table(theta, x, y)) == pytest.approx(expected, abs=1e-9)


@given(angles, lengths, lengths)
def test_to_body_undoes_to_table(theta, x, y):
    assert to_body(theta, *to_table(theta, x, y)) == pytest.approx((x, y), abs=1e-9)
    assert to_table(theta, *to_body(theta, x, y)) == pytest.approx((x, y), abs=1e-9)


@given(angles, angles, lengths, lengths)
def test_two_turns_are_one_turn_by_the_sum(one, other, x, y):
    assert to_table(one, *to_table(other, x, y)) == pytest.approx(
        to_table(one + other, x, y), abs=1e-8
    )


@given(lengths, lengths)
def test_no_turn_changes_nothing(x, y):
    assert to_body(0.0, x, y) == (x, y)
    assert to_table(0.0, x, y) == (x, y)


@given(angles, lengths, lengths)
def test_a_turn_keeps_lengths(theta, x, y):
    assert math.hypot(*to_body(theta, x, y)) == pytest.approx(math.hypot(x, y), abs=1e-9)


@given(angles, lengths, lengths, lengths, lengths, st.floats(-10.0, 10.0))
def test_a_point_of_a_turning_body_moves_as_its_place_changes(theta, x, y, vx, vy, omega):
    arm = to_table(theta, x, y)
    after, before = (to_table(theta + sign * 1e-4 * omega, x, y) for sign in (1.0, -1.0))
    rates = [(a - b) / 2e-4 for a, b in zip(after, before, strict=True)]
    found = velocity_at(vx, vy, omega, *arm)
    assert found == pytest.approx((vx + rates[0], vy + rates[1]), abs=1e-2)
