"""LQR: Riccati's closed form, nothing left on the goal, in orbit and on the table."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from controllers.lqr import LqrParams, lqr
from controllers.sampled import generator
from testbed.core.law import Goal


def flown(law, own, world, no_neighbours, periods, period=0.1):
    others = no_neighbours(len(own.p))
    state = law.initial(own, others, world)
    for k in range(periods):
        ahead = law.propagate(state, own, others, world, k * period, period, 100)
        state, own = ahead.law_state, own._replace(p=ahead.p, v=ahead.v)
    return own


def test_gain_is_the_closed_form_of_a_double_integrator(at_rest, fixed_world, no_neighbours):
    # continuous time: a = -w^2 e - sqrt(2 w^2 + (accel/speed)^2) e', w^2 = accel/error
    params = LqrParams(error=2.0, speed=0.5, accel=0.08)
    stiffness = 0.08 / 2.0
    damping = math.sqrt(2.0 * stiffness + (0.08 / 0.5) ** 2)
    own = at_rest([1.0, 0.0], mass=3.0)._replace(v=np.array([0.0, 1.0]))
    ahead = lqr(params, 2).propagate(
        np.zeros(0), own, no_neighbours(2), fixed_world([0.0, 0.0]), 0.0, 1e-4, 1
    )
    assert ahead.mean_force == pytest.approx(-3.0 * np.array([stiffness, damping]), rel=1e-3)


@pytest.mark.parametrize("d", [2, 3])
def test_it_comes_to_rest_on_its_goal(d, at_rest, fixed_world, no_neighbours):
    own, world = at_rest([3.0, -1.0, 2.0][:d], mass=12.5), fixed_world(np.ones(d))
    end = flown(lqr(LqrParams(), d), own, world, no_neighbours, 1200)
    assert end.p == pytest.approx(np.ones(d), abs=1e-5)


def test_a_known_drift_leaves_no_steady_error_if_it_is_fed(at_rest, fixed_world, no_neighbours):
    own, world = (
        at_rest([1.0, 0.0])._replace(disturbance=np.array([0.01, -0.02])),
        fixed_world([0, 0]),
    )
    fed = flown(lqr(LqrParams(feed="disturbance"), 2), own, world, no_neighbours, 2000)
    left = flown(lqr(LqrParams(feed="none"), 2), own, world, no_neighbours, 2000)
    assert fed.p == pytest.approx(np.zeros(2), abs=1e-6)
    # w^2 = accel/error in continuous time
    assert left.p == pytest.approx(own.disturbance / (0.02 / 1.0), rel=0.02)


@pytest.mark.parametrize("d", [2, 3])
def test_in_orbit_it_holds_a_goal_that_the_orbit_pulls_away_from(
    d, at_rest, fixed_world, no_neighbours
):
    n = 1.1e-3
    goal = np.array([50.0, -200.0, 30.0][:d])
    params = LqrParams(error=10.0, speed=0.5, accel=1e-3, feed="orbit", mean_motion=n)
    law, world = lqr(params, d), fixed_world(goal)
    f, g = generator(n, d)
    x, h = np.concatenate((goal + 20.0, np.zeros(d))), 10.0
    for k in range(300):
        own = at_rest(x[:d])._replace(v=x[d:])
        force = law.propagate(np.zeros(0), own, no_neighbours(d), world, k * h, h, 10).mean_force
        x = solve_ivp(lambda t, y, a: f @ y + g @ a, (0.0, h), x, args=(force,), rtol=1e-10).y[
            :, -1
        ]
    assert x[:d] == pytest.approx(goal, abs=1e-3)
    assert x[d:] == pytest.approx(np.zeros(d), abs=1e-5)


def test_it_follows_a_goal_that_moves(at_rest, fixed_world, no_neighbours):
    law, own, h, t = lqr(LqrParams(), 2), at_rest([0.0, 0.0]), 0.1, 0.0
    for _ in range(600):
        goal = Goal(np.array([0.01 * t, 1.0]), np.array([0.01, 0.0]), np.zeros(2), np.zeros(2))
        world = fixed_world([0.0, 0.0])._replace(goal=goal)
        ahead = law.propagate(np.zeros(0), own, no_neighbours(2), world, t, h, 1)
        own, t = own._replace(p=ahead.p, v=ahead.v), t + h
    assert own.p == pytest.approx([0.01 * t, 1.0], abs=2e-3)


def test_force_is_bounded(at_rest, fixed_world, no_neighbours):
    own = at_rest([100.0, 50.0], max_force=0.3)
    ahead = lqr(LqrParams(), 2).propagate(
        np.zeros(0), own, no_neighbours(2), fixed_world([0.0, 0.0]), 0.0, 0.1, 1
    )
    assert np.linalg.norm(ahead.mean_force) == pytest.approx(0.3)
    assert ahead.mean_force[0] == pytest.approx(2.0 * ahead.mean_force[1])


@pytest.mark.parametrize(
    ("feed", "motion"), [("orbit", 0.0), ("disturbance", 1e-3), ("none", 1e-3)]
)
def test_an_orbit_without_a_mean_motion_is_refused(feed, motion):
    with pytest.raises(ValueError, match="expected mean_motion > 0 with feed"):
        LqrParams(feed=feed, mean_motion=motion)
