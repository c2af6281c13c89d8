"""`propagate` against closed forms, and its order of convergence where it has none."""

import copy
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.pd import PdParams, pd
from controllers.plain_law import propagate_plain
from controllers.sotsmc import SotsmcParams, sotsmc
from testbed.core.law import (
    Body,
    Discs,
    Goal,
    World,
    bounded,
    propagate,
    propagate_in_plane,
    silent,
)

MASS = 12.5  # [kg]
UNBOUNDED = 1e9  # [N]


class Push:
    """The same force for ever."""

    def __init__(self, force):
        self.force = np.array(force)

    def rate(self, law_state, own, neighbours, world, t):
        return self.force, np.zeros(len(law_state))


class FaultMonitor:
    """No force; writes down what it is shown."""

    def __init__(self):
        self.seen = []

    def rate(self, law_state, own, neighbours, world, t):
        self.seen.append((t, copy.deepcopy((own, neighbours, world))))
        return np.zeros(len(own.p)), np.zeros(0)


class Clockwork:
    """Force and law state that are known functions of time."""

    def rate(self, law_state, own, neighbours, world, t):
        return np.array([math.cos(t), -2.0 * t]), np.array([math.sin(t)])


def discs(rng, n, d):
    return Discs(rng.normal(size=(n, d)), rng.normal(size=(n, d)), rng.uniform(0.1, 1.0, n))


def scene(seed, d=2):
    """A moving satellite among moving things, with a goal that moves."""
    rng = np.random.default_rng(seed)

    def vector(scale):
        return scale * rng.normal(size=d)

    own = Body(vector(1.0), vector(0.1), MASS, vector(0.01), vector(0.003), UNBOUNDED)
    goal = Goal(vector(1.0), vector(0.1), vector(0.05), vector(0.02))
    return own, silent(discs(rng, 2, d)), World(goal, discs(rng, 3, d))


def steady(own):
    """The same with a constant drift."""
    return own._replace(disturbance_rate=np.zeros_like(own.p))


def bits(values):
    """Arrays and numbers nested in tuples, as bytes."""
    return [bits(v) for v in values] if isinstance(values, tuple) else np.asarray(values).tobytes()


def order(errors):
    """Observed order of convergence from errors at halved steps."""
    return math.log2(errors[-2] / errors[-1])


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("steps", [1, 2, 7, 100])
def test_constant_force_is_exact(steps, d):
    own, others, world = scene(steps, d)
    own = steady(own)
    force = np.arange(1.0, d + 1.0)

    ahead = propagate_plain(Push(force), np.zeros(0), own, others, world, 3.0, 0.7, steps)

    a = force / MASS + own.disturbance
    assert ahead.p == pytest.approx(own.p + 0.7 * own.v + 0.5 * 0.7**2 * a, abs=1e-14)
    assert ahead.v == pytest.approx(own.v + 0.7 * a, abs=1e-14)
    assert ahead.mean_force == pytest.approx(force, abs=1e-13)


def test_the_world_moves_on_between_sub_steps():
    own, others, world = scene(1)
    world = world._replace(goal=world.goal._replace(jerk=np.zeros(2)))
    watch = FaultMonitor()

    propagate_plain(watch, np.zeros(0), own, others, world, 2.0, 0.8, 8)

    assert [t for t, _ in watch.seen] == pytest.approx(2.0 + 0.1 * np.arange(8))
    for t, (body, heard, around) in watch.seen:
        dt, goal = t - 2.0, world.goal
        assert around.goal.p == pytest.approx(goal.p + dt * goal.v + 0.5 * dt**2 * goal.a)
        assert around.goal.v == pytest.approx(goal.v + dt * goal.a)
        assert around.goal.a == pytest.approx(goal.a)
        assert around.obstacles.p == pytest.approx(world.obstacles.p + dt * world.obstacles.v)
        assert heard.p == pytest.approx(others.p + dt * others.v)
        assert body.disturbance == pytest.approx(own.disturbance + dt * own.disturbance_rate)
        assert body.mass == MASS
        assert body.max_force == UNBOUNDED


def test_order_of_a_goal_with_jerk():
    own, others, world = scene(2)
    goal = world.goal
    end = goal.p + goal.v + goal.a / 2.0 + goal.jerk / 6.0
    errors = []
    for steps in (50, 100, 200):
        watch = FaultMonitor()
        # one step more than needed: the last look is at the end of the second
        propagate_plain(watch, np.zeros(0), own, others, world, 0.0, 1.0 + 1.0 / steps, steps + 1)
        errors.append(np.abs(watch.seen[-1][1][2].goal.p - end).max())
    assert order(errors) == pytest.approx(1.0, abs=0.02)


def test_order_of_a_force_that_varies():
    # p'' = cos t / m in x and -2 t / m in y: held over a step, so first order
    own, others, world = scene(3)
    own = steady(own._replace(disturbance=np.zeros(2)))
    end = own.p + own.v + np.array([1.0 - math.cos(1.0), -1.0 / 3.0]) / MASS
    errors = []
    for steps in (50, 100, 200):
        ahead = propagate_plain(Clockwork(), np.zeros(1), own, others, world, 0.0, 1.0, steps)
        errors.append(np.abs(ahead.p - end).max())
    assert order(errors) == pytest.approx(1.0, abs=0.02)


def test_order_of_the_law_state():
    own, others, world = scene(4)
    errors = []
    for steps in (50, 100, 200):
        ahead = propagate_plain(Clockwork(), np.ones(1), own, others, world, 0.0, 1.0, steps)
        errors.append(abs(ahead.law_state[0] - (2.0 - math.cos(1.0))))
    assert order(errors) == pytest.approx(1.0, abs=0.02)


def test_order_of_the_closed_loop():
    # critically damped: e = (e0 + (v0 + w e0) t) exp(-w t)
    w, t = 0.5, 4.0
    own = Body(np.array([1.0, -0.5]), np.array([0.0, 0.2]), MASS, *np.zeros((2, 2)), UNBOUNDED)
    nothing = Discs(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
    world = World(Goal(*np.zeros((4, 2))), nothing)
    end = (own.p + (own.v + w * own.p) * t) * math.exp(-w * t)
    law = pd(PdParams(bandwidth=w, damping=1.0))
    errors = []
    for steps in (200, 400, 800):
        ahead = law.propagate(np.zeros(0), own, silent(nothing), world, 0.0, t, steps)
        errors.append(np.abs(ahead.p - end).max())
    assert order(errors) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("make", [lambda: pd(PdParams()), lambda: sotsmc(SotsmcParams(), 2)])
def test_arrays_handed_over_are_not_written_to(make):
    law, (own, others, world) = make(), scene(5)
    law_state = law.initial(own, others, world) + 0.125
    handed_over = (law_state, own, others, world)
    before = bits(handed_over)

    law.propagate(*handed_over, 0.0, 0.5, 50)
    law.rate(*handed_over, 0.0)
    propagate_plain(law, *handed_over, 0.0, 0.5, 50)

    assert bits(handed_over) == before


@pytest.mark.parametrize("seed", range(3))
def test_in_the_plane_every_bit_is_the_same(seed):
    law, (own, others, world) = sotsmc(SotsmcParams(), 2), scene(seed)
    flight = law.gains, law.initial(own, others, world) + 0.125, own, others, world, 1.0, 2.0, 200
    assert bits(propagate_in_plane(*flight)) == bits(propagate(*flight))


@pytest.mark.parametrize("seed", range(5))
def test_plain_python_law_flies_like_the_compiled_one(seed):
    law, (own, others, world) = pd(PdParams(bandwidth=0.7)), scene(seed)
    own = own._replace(max_force=5.0)  # bounds the force on the way
    state = np.zeros(0)
    compiled = law.propagate(state, own, others, world, 1.0, 2.0, 200)
    plain = propagate_plain(law, state, own, others, world, 1.0, 2.0, 200)
    for one, other in zip(compiled, plain, strict=True):
        assert one == pytest.approx(other, rel=1e-13)


def test_a_long_flight_is_the_same_in_one_go_or_in_pieces():
    law, (own, others, world) = sotsmc(SotsmcParams(), 2), scene(6)
    goal, still = world.goal._replace(a=np.zeros(2), jerk=np.zeros(2)), np.zeros(2)
    own, world = steady(own._replace(disturbance=still)), world._replace(goal=goal)
    state = law.initial(own, others, world)
    whole = law.propagate(state, own, others, world, 0.0, 1.0, 1000)
    forces = []
    for k in range(10):
        t = 0.1 * k
        ahead = law.propagate(
            state,
            own,
            others._replace(p=others.p + t * others.v),
            World(
                goal._replace(p=goal.p + t * goal.v),
                world.obstacles._replace(p=world.obstacles.p + t * world.obstacles.v),
            ),
            t,
            0.1,
            100,
        )
        state, own = ahead.law_state, own._replace(p=ahead.p, v=ahead.v)
        forces.append(ahead.mean_force)
    assert own.p == pytest.approx(whole.p, rel=1e-9)
    assert own.v == pytest.approx(whole.v, rel=1e-9)
    assert state == pytest.approx(whole.law_state, rel=1e-9)
    assert np.mean(forces, axis=0) == pytest.approx(whole.mean_force, rel=1e-9)


vectors = st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=3).map(np.array)


@given(vectors, st.floats(0.0, 1e6))
def test_bounded_never_exceeds_the_limit(force, limit):
    assert np.linalg.norm(bounded(force, limit)) <= limit * (1.0 + 1e-12)


@given(vectors, st.floats(1e-3, 1e6))
def test_bounded_keeps_the_direction(force, limit):
    short = bounded(force, limit)
    size = np.linalg.norm(force)
    assert short * max(size, limit) == pytest.approx(force * limit, rel=1e-9, abs=1e-9)


@given(vectors)
def test_bounded_leaves_a_short_force_alone(force):
    assert (bounded(force, np.linalg.norm(force) * (1.0 + 1e-9) + 1e-300) == force).all()
