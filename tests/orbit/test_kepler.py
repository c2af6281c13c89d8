import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from sim_twin.orbit.kepler import Orbit, eccentric_of_mean, mean_of_true, orbit_of, true_of_mean

MU = 3.986004418e14


@given(st.floats(-20.0, 20.0), st.floats(0.0, 0.97))
def test_kepler_equation_is_solved(mean, e):
    x = eccentric_of_mean(mean, e)
    assert x - e * math.sin(x) == pytest.approx(mean, rel=1e-14, abs=1e-14)


@pytest.mark.parametrize("e", [0.0, 0.0002, 0.3, 0.79, 0.81, 0.95])
def test_kepler_equation_as_bisection_solves_it(e):
    for mean in np.linspace(0.01, 3.1, 40):
        wanted = brentq(lambda x, m=mean: x - e * math.sin(x) - m, 0.0, 4.0, xtol=1e-15)
        assert eccentric_of_mean(mean, e) == pytest.approx(wanted, abs=1e-14)


@given(st.floats(-20.0, 20.0), st.floats(0.0, 0.9))
def test_true_and_mean_anomaly_are_inverse_also_over_many_turns(theta, e):
    assert true_of_mean(mean_of_true(theta, e), e) == pytest.approx(theta, abs=2e-13 / (1 - e))


def test_anomaly_counts_on_after_a_turn():
    orbit = Orbit(a=7000e3, e=0.3, theta=1.0)
    period = 2 * math.pi / orbit.mean_motion
    assert orbit.theta_at(2 * period) == pytest.approx(1.0 + 4 * math.pi, abs=1e-12)
    assert all(
        orbit.theta_at(t + 1.0) > orbit.theta_at(t) for t in np.linspace(0.0, 3 * period, 200)
    )


def test_position_on_the_orbit_is_where_gravity_takes_the_satellite():
    orbit = Orbit(a=9000e3, e=0.25, i=1.1, node=2.0, perigee=4.0, theta=0.7)
    start = np.concatenate(orbit.eci())
    found = solve_ivp(
        lambda t, y: np.concatenate([y[3:], -MU * y[:3] / np.linalg.norm(y[:3]) ** 3]),
        (0.0, 5000.0), start, method="DOP853", rtol=1e-13, atol=1e-8,
    )  # fmt: skip
    r, v = orbit.eci(5000.0)
    assert np.linalg.norm(found.y[:3, -1] - r) < 1e-5
    assert np.linalg.norm(found.y[3:, -1] - v) < 1e-8


angles = st.floats(0.0, 6.28)


@given(st.floats(0.001, 0.9), st.floats(0.001, 3.14), angles, angles, angles)
def test_elements_to_eci_and_back(e, i, node, perigee, theta):
    orbit = Orbit(a=8000e3, e=e, i=i, node=node, perigee=perigee, theta=theta)
    back = orbit_of(*orbit.eci())
    assert back.a == pytest.approx(orbit.a, rel=1e-11)
    assert back.e == pytest.approx(e, abs=1e-12)
    assert back.i == pytest.approx(i, abs=1e-11)
    for name in ("node", "perigee", "theta"):
        gap = getattr(back, name) - getattr(orbit, name)
        assert abs(math.remainder(gap, 2 * math.pi)) < 1e-9 / min(e, math.sin(i))


@pytest.mark.parametrize(
    ("e", "i"), [(0.0, 0.0), (0.0, 1.0), (0.2, 0.0), (0.0, math.pi), (0.2, math.pi), (1e-13, 1e-13)]
)
def test_angles_without_a_meaning_are_zero_and_the_place_is_kept(e, i):
    orbit = Orbit(a=7000e3, e=e, i=i, theta=1.3)
    back = orbit_of(*orbit.eci())
    assert math.sin(i) > 1e-3 or back.node == 0.0
    assert e > 1e-3 or back.perigee == 0.0
    assert all(0.0 <= angle < 2 * math.pi for angle in (back.node, back.perigee, back.theta))
    for wanted, found in zip(orbit.eci(700.0), back.eci(700.0), strict=True):
        assert found == pytest.approx(wanted, rel=1e-11, abs=1e-11 * np.linalg.norm(wanted))


def test_textbook_example():
    # Vallado, "Fundamentals of Astrodynamics and Applications", 4th ed., example 2-5, in km
    r = np.array([6524.834, 6862.875, 6448.296]) * 1e3
    v = np.array([4.901327, 5.533756, -1.976341]) * 1e3
    orbit = orbit_of(r, v)
    assert orbit.a == pytest.approx(36127.343e3, rel=1e-6)
    assert orbit.e == pytest.approx(0.832853, abs=1e-6)
    degrees = [math.degrees(x) for x in (orbit.i, orbit.node, orbit.perigee, orbit.theta)]
    assert degrees == pytest.approx([87.870, 227.898, 53.38, 92.335], abs=0.006)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"e": 1.0}, "0 <= e < 1, found e = 1.0"),
        ({"e": -0.1}, "0 <= e < 1"),
        ({"e": math.nan}, "0 <= e < 1"),
        ({"a": 0.0}, "a > 0"),
        ({"a": math.inf}, "a > 0"),
        ({"mu": -1.0}, "mu > 0"),
    ],
)
def test_orbits_that_are_none_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        Orbit(**({"a": 7000e3} | changes))


@pytest.mark.parametrize(
    ("r", "v"),
    [((7e6, 0, 0), (0, 11e3, 0)), ((7e6, 0, 0), (100.0, 0, 0)), ((0, 0, 0), (0, 0, 0))],
)
def test_a_state_that_is_on_no_ellipse_is_refused(r, v):
    with pytest.raises(ValueError, match="expected an elliptic orbit"):
        orbit_of(np.array(r, dtype=float), np.array(v, dtype=float))
