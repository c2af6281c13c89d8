"""PD against the closed forms of a damped oscillator."""

import math

import numpy as np
import pytest

from controllers.pd import PdParams, pd

FINE = 100  # steps per second


def flown(params, own, world, no_neighbours, duration):
    others = no_neighbours(len(own.p))
    return pd(params).propagate(
        np.zeros(0), own, others, world, 0.0, duration, round(duration * FINE)
    )


def closed_form(w, z, e, v, t):
    """Error at `t` of e'' + 2 z w e' + w^2 e = 0."""
    if z == 1.0:
        return (e + (v + w * e) * t) * math.exp(-w * t)
    if z < 1.0:
        beat = w * math.sqrt(1.0 - z * z)
        wave = e * math.cos(beat * t) + (v + z * w * e) / beat * math.sin(beat * t)
        return wave * math.exp(-z * w * t)
    slow, fast = (w * (-z + sign * math.sqrt(z * z - 1.0)) for sign in (1.0, -1.0))
    share = (v - fast * e) / (slow - fast)
    return share * math.exp(slow * t) + (e - share) * math.exp(fast * t)


@pytest.mark.parametrize("damping", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("t", [1.0, 5.0, 20.0])
def test_error_is_that_of_a_damped_oscillator(damping, t, at_rest, fixed_world, no_neighbours):
    w, v = 0.2, np.array([0.0, 0.3, -0.1])
    own = at_rest([2.0, -1.0, 0.5], mass=12.5)._replace(v=v)
    world = fixed_world([0.5, 0.5, 0.0])
    ahead = flown(PdParams(bandwidth=w, damping=damping), own, world, no_neighbours, t)
    error = own.p - world.goal.p
    expected = [closed_form(w, damping, e, s, t) for e, s in zip(error, v, strict=True)]
    assert ahead.p - world.goal.p == pytest.approx(np.array(expected), abs=3e-3)


def test_rate_of_convergence_is_the_bandwidth(at_rest, fixed_world, no_neighbours):
    # e ~ t exp(-w t) when critically damped
    own, world = at_rest([1.0, 0.0]), fixed_world([0.0, 0.0])
    half, whole = (flown(PdParams(), own, world, no_neighbours, t).p[0] for t in (100.0, 200.0))
    assert math.log(half / whole * (1 + 20.0) / (1 + 10.0)) / 100.0 == pytest.approx(0.1, rel=0.01)


def test_equilibrium_at_the_goal(at_rest, fixed_world, no_neighbours):
    own, world = at_rest([1.0, 2.0]), fixed_world([1.0, 2.0], [[1.0, 0.0]])
    force, _ = pd(PdParams()).rate(np.zeros(0), own, no_neighbours(2), world, 0.0)
    assert (force == 0.0).all()


@pytest.mark.parametrize("seed", range(5))
def test_force_is_the_formula(seed, random_scene):
    own, neighbours, world = random_scene(seed, 2, mass=3.0)
    force, _ = pd(PdParams(bandwidth=0.5, damping=0.7)).rate(
        np.zeros(0), own, neighbours, world, 0.0
    )
    goal = world.goal
    feedback = 0.25 * (goal.p - own.p) + 0.7 * (goal.v - own.v)
    assert force == pytest.approx(3.0 * (feedback + goal.a - own.disturbance), rel=1e-12)


def test_a_known_drift_leaves_no_steady_error(at_rest, fixed_world, no_neighbours):
    own = at_rest([1.0, 0.0])._replace(disturbance=np.array([0.02, -0.03]))
    ahead = flown(PdParams(), own, fixed_world([0.0, 0.0]), no_neighbours, 300.0)
    assert ahead.p == pytest.approx(np.zeros(2), abs=1e-9)


def test_it_is_blind_to_obstacles(at_rest, fixed_world, no_neighbours):
    own, law = at_rest([1.0, 0.0]), pd(PdParams())
    bare, _ = law.rate(np.zeros(0), own, no_neighbours(2), fixed_world([0.0, 0.0]), 0.0)
    crowded, _ = law.rate(
        np.zeros(0), own, no_neighbours(2), fixed_world([0.0, 0.0], [[0.5, 0.0]]), 0.0
    )
    assert (bare == crowded).all()


def test_force_is_bounded_and_keeps_its_direction(random_scene):
    own, neighbours, world = random_scene(3, 3)
    law = pd(PdParams())
    free, _ = law.rate(np.zeros(0), own, neighbours, world, 0.0)
    short, _ = law.rate(np.zeros(0), own._replace(max_force=0.1), neighbours, world, 0.0)
    assert short == pytest.approx(0.1 * free / np.linalg.norm(free), rel=1e-12)
