"""One motion of the cameras' frame explains where several vehicles are seen, or it does not."""

import cmath
import math

import numpy as np
import pytest

from testbed.core.types import Accel, Pose, PoseSample, State, Twist
from testbed.flight.moved_frame import how_moved, sight_of

PLACES = [(1.4, -1.4, 0.2), (0.1, -1.3, -2.0), (-1.2, 0.8, 3.0)]  # x, y [m], theta [rad]
NOISE = 2e-4  # [m, rad]


def sights(change, places=PLACES, speed=0.0):
    """Vehicles as seen after `change(k, place, heading)`, which gives a place and a turn."""
    rng, found = np.random.default_rng(0), []
    for k, (x, y, theta) in enumerate(places):
        state = still(x, y, theta, speed * (k + 1))
        place, turn = change(k, complex(x, y), theta)
        dx, dy, dt = NOISE * rng.standard_normal(3)
        seen = PoseSample(state.t, place.real + dx, place.imag + dy, theta + turn + dt)
        found.append(sight_of(state, seen))
    return found


def still(x, y, theta, vx):
    return State(1.0, Pose(x, y, theta), Twist(vx, 0.0, 0.0), Accel(0.0, 0.0, 0.0), 0.02, 0)


def turned(degrees, shift=0.0):
    turn = math.radians(degrees)
    return lambda k, place, theta: (cmath.exp(1j * turn) * place + shift, turn)


@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda k, place, theta: (place + 0.12j, 0.0), "all by 120 mm"),
        (lambda k, place, theta: (place + 0.01, 0.0), "all by 10 mm"),
        (turned(1.5), "a turn of 1.5 deg and a shift of 0.00 m"),
        (turned(-30.0), "a turn of -30.0 deg"),
        (turned(170.0, 0.4 - 0.3j), "a turn of 170.0 deg and a shift of 0.50 m"),
        (lambda k, place, theta: (1000.0 * place, 0.0), "all 1000 times as far from the origin"),
        (lambda k, place, theta: (0.9 * place, 0.0), "all 0.9 times as far"),
        (lambda k, place, theta: (complex(place.real, 0.2), -theta), "all on a line"),
    ],
)
def test_a_frame_that_moved_is_told_by_two_vehicles(change, words, count):
    assert words in how_moved(sights(change, PLACES[:count]))


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize(
    "change",
    [
        lambda k, place, theta: (place, 0.0),  # nothing
        lambda k, place, theta: (place + 0.3 * (k == 0), 0.0),  # one jumps
        lambda k, place, theta: (place + 0.07j * (k == 0), 0.0),
        lambda k, place, theta: (place, 1.0 * (k == 0)),  # one turns
        lambda k, place, theta: (place + 0.3 * 1j**k, 0.0),  # each goes its own way
        lambda k, place, theta: (place + 0.3, 0.5 * k),  # its headings do not fit
    ],
)
def test_what_one_motion_does_not_explain_is_no_frame(change, count):
    assert how_moved(sights(change, PLACES[:count])) == ""


def test_one_vehicle_cannot_tell():
    assert how_moved(sights(turned(20.0), PLACES[:1])) == ""


def test_poses_that_are_all_late_are_no_frame():
    late = 0.8  # [s]
    assert how_moved(sights(lambda k, p, theta: (p - late * 0.1 * (k + 1), 0.0), speed=0.1)) == ""


def test_two_bodies_that_were_swapped_look_as_if_the_frame_had_turned_half_round():
    places = [(1.0, 0.0, 0.0), (-1.0, 0.0, math.pi), (0.0, 1.5, 0.0)]
    half_round = sights(turned(180.0), places)
    assert how_moved(half_round[:2]) != ""
    assert how_moved(half_round[:2], swapped=True) == ""
    assert how_moved(half_round, swapped=True) != ""
    third_stays = [*half_round[:2], *sights(turned(0.0), places)[2:]]
    assert how_moved(third_stays, swapped=True) == how_moved(third_stays) == ""
