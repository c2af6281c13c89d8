import math

import numpy as np
import pytest

from sim_twin.orbit import smooth
from sim_twin.orbit.clohessy_wiltshire import drift_all, transition
from sim_twin.orbit.frames import NADIR
from sim_twin.orbit.gravity import EARTH, POINT_EARTH
from sim_twin.orbit.kepler import Orbit
from sim_twin.orbit.relative import chief_on, drift, frame_of_anomaly
from sim_twin.orbit.swarm import fly
from sim_twin.orbit.system import Coast

CIRCLE = Orbit(a=6978e3, i=math.radians(98.0))
W = CIRCLE.mean_motion


def rate(t, y):
    a = np.empty((1, 3))
    drift_all(W, y[None, :3], y[None, 3:], a)
    return np.concatenate([y[3:], a[0]])


@pytest.mark.parametrize("seconds", [1.0, 500.0, 2000.0, 20000.0])
def test_integration_agrees_with_the_closed_form(seconds):
    start = np.array([500.0, -300.0, 200.0, 0.3, 0.2, -0.5])
    found = smooth.solve(rate, start, (0.0, seconds))[-1]
    assert found == pytest.approx(transition(W, seconds) @ start, rel=1e-10, abs=1e-7)


def test_transitions_follow_each_other():
    whole, halves = transition(W, 3000.0), transition(W, 1800.0) @ transition(W, 1200.0)
    assert halves == pytest.approx(whole, rel=1e-9, abs=1e-9)
    assert transition(W, 0.0) == pytest.approx(np.eye(6))
    assert np.linalg.det(whole) == pytest.approx(1.0)  # the motion keeps volumes


def test_it_is_the_relative_motion_linearised():
    # a tenth of the distance leaves a hundredth of the error
    frame = frame_of_anomaly(chief_on(CIRCLE), 0.0)
    p, v = np.array([300.0, -400.0, 500.0]), np.array([0.1, 0.2, -0.3])  # gao2022's axes

    def gap(scale):
        a = np.empty((1, 3))
        drift_all(W, scale * p[None], scale * v[None], a)
        exact = NADIR @ drift(frame, NADIR.T @ (scale * p), NADIR.T @ (scale * v))
        return np.linalg.norm(a[0] - exact)

    assert gap(1.0) < 3e-4 * np.linalg.norm(W * W * p)
    assert gap(0.1) == pytest.approx(1e-2 * gap(1.0), rel=1e-2)


def worst_gap(orbit, planet, seconds):
    """Largest gap [m] 0.5 km away in 40 directions, at rest in the turning frame."""
    rng = np.random.default_rng(5)
    p = rng.normal(size=(40, 3))
    p *= 500.0 / np.linalg.norm(p, axis=1)[:, None]
    centre = np.concatenate(orbit.eci())
    flight = fly(Coast(), centre, p, np.zeros((40, 3)), (0.0, seconds), axes=NADIR, planet=planet)
    linear = np.concatenate([p, np.zeros((40, 3))], axis=1) @ transition(W, seconds).T
    return np.linalg.norm(flight.p[-1] - linear[:, :3], axis=1).max()


def test_how_well_it_holds_over_half_a_kilometre():
    assert worst_gap(CIRCLE, POINT_EARTH, 500.0) == pytest.approx(0.018, rel=0.5)
    assert worst_gap(CIRCLE, POINT_EARTH, 2000.0) == pytest.approx(1.7, rel=0.5)


def test_j2_and_eccentricity_are_not_in_it(gao_orbit):
    assert worst_gap(gao_orbit, EARTH, 2000.0) > 2.0 * worst_gap(CIRCLE, POINT_EARTH, 2000.0)
