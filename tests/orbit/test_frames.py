import math

import numpy as np
import pytest

from sim_twin.orbit.frames import NADIR, RADIAL, moving, to_eci, to_relative, turned_to_eci
from sim_twin.orbit.gravity import EARTH, POINT_EARTH, pull
from sim_twin.orbit.kepler import Orbit
from sim_twin.orbit.swarm import fly
from sim_twin.orbit.system import Coast

ORBIT = Orbit(a=7200e3, e=0.1, i=1.2, node=0.5, perigee=2.0, theta=0.9)


def frame_on(orbit, choice, planet=POINT_EARTH):
    r, v = orbit.eci()
    return moving(r, v, np.array(pull(planet, *r)), choice)


@pytest.mark.parametrize("choice", [RADIAL, NADIR])
def test_axes_are_right_handed_and_turn_as_said(choice):
    frame = frame_on(ORBIT, choice)
    assert frame.axes @ frame.axes.T == pytest.approx(np.eye(3), abs=1e-15)
    assert np.linalg.det(frame.axes) == pytest.approx(1.0)


def test_radial_axes_point_where_they_say():
    r, v = ORBIT.eci()
    x, y, z = frame_on(ORBIT, RADIAL).axes
    assert x == pytest.approx(r / np.linalg.norm(r))
    assert y @ v > 0.0
    assert z == pytest.approx(np.cross(r, v) / np.linalg.norm(np.cross(r, v)))


def test_gao2022s_axes_point_forward_against_the_normal_and_down():
    r, v = ORBIT.eci()
    x, y, z = frame_on(ORBIT, NADIR).axes
    assert x @ v > 0.0
    assert y == pytest.approx(-np.cross(r, v) / np.linalg.norm(np.cross(r, v)))
    assert z == pytest.approx(-r / np.linalg.norm(r))


@pytest.mark.parametrize("choice", [RADIAL, NADIR])
@pytest.mark.parametrize("planet", [POINT_EARTH, EARTH._replace(j2=0.1)])
def test_the_turn_rate_is_how_the_axes_turn(choice, planet):
    centre = np.concatenate(ORBIT.eci())
    none, h = np.zeros((1, 3)), 0.5
    path = fly(
        Coast(), centre, none, none, 100.0 + h * np.arange(-2, 3), axes=choice, planet=planet
    ).centre
    axes = [moving(y[:3], y[3:], np.array(pull(planet, *y[:3])), choice) for y in path]
    a = [frame.axes for frame in axes]
    slope = (a[0] - 8 * a[1] + 8 * a[3] - a[4]) / (12 * h)
    turn = slope @ a[2].T  # rows: d(axis)/dt in the axes, = -[omega x]
    found = np.array([turn[1, 2], turn[2, 0], turn[0, 1]])
    assert axes[2].omega == pytest.approx(found, abs=1e-11)
    tilts = RADIAL[0] if choice is RADIAL else NADIR[:, 0]
    plane_turns = abs(axes[2].omega @ tilts) > 1e-7
    assert plane_turns == (planet.j2 > 0.0)


@pytest.mark.parametrize("choice", [RADIAL, NADIR])
def test_there_and_back(choice):
    rng = np.random.default_rng(6)
    p, q = 1e3 * rng.normal(size=(6, 3)), rng.normal(size=(6, 3))
    frame = frame_on(ORBIT, choice, EARTH)
    r, v, back_p, back_q = (np.empty((6, 3)) for _ in range(4))
    to_eci(frame, p, q, r, v)
    to_relative(frame, r, v, back_p, back_q)
    assert back_p == pytest.approx(p, abs=1e-8)
    assert back_q == pytest.approx(q, abs=1e-11)


def test_at_rest_in_the_frame_is_turning_with_it():
    frame = frame_on(ORBIT, RADIAL)
    r, v = np.empty((1, 3)), np.empty((1, 3))
    to_eci(frame, np.array([[0.0, 0.0, 0.0]]), np.zeros((1, 3)), r, v)
    assert (r[0].tolist(), v[0].tolist()) == (frame.r.tolist(), frame.v.tolist())
    to_eci(frame, np.array([[1000.0, 0.0, 0.0]]), np.zeros((1, 3)), r, v)
    speed = math.sqrt(np.sum((v[0] - frame.v) ** 2))
    assert speed == pytest.approx(1000.0 * ORBIT.momentum / np.sum(frame.r**2), rel=1e-6)


def test_thrust_is_turned_and_nothing_else():
    frame, out = frame_on(ORBIT, NADIR), np.empty((1, 3))
    turned_to_eci(frame, np.array([[1.0, 2.0, 3.0]]), out)
    assert out[0] == pytest.approx(frame.axes.T @ [1.0, 2.0, 3.0])
