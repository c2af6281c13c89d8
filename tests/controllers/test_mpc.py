"""MPC: its programs against another solver, its flights against what was asked of it."""

import numpy as np
import pytest
from scipy.optimize import minimize, nnls

import controllers.mpc as module
from controllers.lqr import LqrParams, lqr
from controllers.mpc import PLAN, Mpc, MpcParams, directions, mpc, solved, tangents
from controllers.sampled import feedback, sampled, weights
from testbed.core.law import Discs, Neighbours, World


def discs(*rows, d=2):
    """From (centre, velocity, radius)."""
    p, v = (np.array([row[k] for row in rows], dtype=float).reshape(-1, d) for k in (0, 1))
    return Discs(p, v, np.array([row[2] for row in rows], dtype=float))


def fly(law, own, others, world, seconds, period=0.1):
    """Track (n, d) and the law's state at the end; discs move on."""
    state, track, t = law.initial(own, others, world), [own.p], 0.0
    while t < seconds - 1e-9:
        ahead = law.propagate(state, own, others, world, t, period, 10)
        state, own, t = ahead.law_state, own._replace(p=ahead.p, v=ahead.v), t + period
        obstacles = world.obstacles
        world = world._replace(obstacles=obstacles._replace(p=obstacles.p + period * obstacles.v))
        others = others._replace(p=others.p + period * others.v)
        track.append(own.p)
    return np.array(track), state, own


def clearance(track, obstacles, period=0.1):
    centres = obstacles.p + period * np.arange(len(track))[:, None, None] * obstacles.v
    return (np.linalg.norm(track[:, None] - centres, axis=2) - obstacles.radius).min()


# The program


def by_slsqp(program, start):
    """What a solver for anything finds from another start."""
    scale = np.sqrt(np.diag(program.h))
    scale[: program.m] = 10.0
    h, f, a = program.h / np.outer(scale, scale), program.f / scale, program.a / scale
    return minimize(
        lambda z: 0.5 * z @ h @ z + f @ z,
        start * scale,
        jac=lambda z: h @ z + f,
        bounds=[(0.0, None)] * program.m + [(None, None)] * (len(f) - program.m),
        constraints={"type": "ineq", "fun": lambda z: program.upper - a @ z, "jac": lambda z: -a},
        method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-12},
    ).x / scale  # fmt: skip


def unexplained(program, z):
    """What of the cost's slope at `z` no constraint that binds holds up: 0 only at the optimum."""
    rows = np.concatenate((program.a, -np.eye(len(z))[: program.m]))
    room = np.concatenate((program.upper, np.zeros(program.m))) - rows @ z
    binding = rows[room < 1e-7]
    slope = program.h @ z + program.f
    size = np.linalg.norm(binding, axis=1)
    return nnls((binding / size[:, None]).T, -slope)[1] / np.linalg.norm(slope)


def scene(seed, d, at_rest, fixed_world, no_neighbours):
    rng = np.random.default_rng(seed)
    own = at_rest(rng.uniform(-2.0, 2.0, d), mass=12.0, max_force=0.6)
    own = own._replace(v=0.1 * rng.normal(size=d), disturbance=1e-3 * rng.normal(size=d))
    goal = -own.p + 0.3 * rng.normal(size=d)
    middle = 0.5 * (own.p + goal) + 0.3 * rng.normal(size=d)
    world = fixed_world(goal)
    obstacles = discs((middle, 0.02 * rng.normal(size=d), 0.8), d=d)
    return own, no_neighbours(d), World(world.goal, obstacles)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_a_program_is_solved(seed, d, at_rest, fixed_world, no_neighbours):
    law = Mpc(MpcParams(steps=6, step_s=2.0), d)
    own, others, world = scene(seed, d, at_rest, fixed_world, no_neighbours)
    plan = np.zeros(6 * d)
    program = law.program(plan, own, others, world)
    z = solved(program, plan)
    # of a convex program, a feasible point whose slope is held up by binding constraints is the one
    assert np.max(program.a @ z - program.upper) < 1e-6
    assert np.min(z[: program.m]) > -1e-9
    assert unexplained(program, z) < 1e-6
    assert np.max(program.a @ z - program.upper) > -1e-6  # and some of them do bind

    def cost(z):
        return 0.5 * z @ program.h @ z + program.f @ z

    other = by_slsqp(program, np.concatenate((np.ones(program.m), plan)))
    assert cost(z) <= cost(other) + 1e-6 * abs(cost(other))
    assert cost(other) == pytest.approx(cost(z), rel=0.01)


def test_without_constraints_it_is_the_lqr(at_rest, fixed_world, no_neighbours):
    weights = {"error": 1.0, "speed": 0.3, "accel": 0.02}
    own, world = at_rest([1.0, -0.5], mass=3.0), fixed_world([0.0, 0.2])
    own = own._replace(v=np.array([0.1, 0.05]), disturbance=np.array([1e-3, 2e-3]))
    plans = mpc(MpcParams(**weights, steps=5, step_s=0.5), 2)
    state = plans.initial(own, no_neighbours(2), world)
    planned = plans.propagate(state, own, no_neighbours(2), world, 0.0, 0.5, 1)
    regulated = lqr(LqrParams(**weights), 2).propagate(
        np.zeros(0), own, no_neighbours(2), world, 0.0, 0.5, 1
    )
    assert planned.mean_force == pytest.approx(regulated.mean_force, rel=1e-6)


@pytest.mark.parametrize("d", [2, 3])
def test_facets_lie_inside_the_ball_and_touch_it(d):
    normals, inscribed = directions(d)
    assert len(normals) == 3**d - 1
    rays = np.random.default_rng(0).normal(size=(20_000, d))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    furthest = inscribed / (rays @ normals.T).max(axis=1)  # along each ray
    assert furthest.max() <= 1.0 + 1e-12
    assert furthest.max() > 0.998
    assert furthest.min() == pytest.approx(inscribed, abs=0.02)


@pytest.mark.parametrize("d", [2, 3])
def test_a_tangent_is_of_length_one_and_tilts_towards_the_goal(d):
    rng = np.random.default_rng(1)
    path, centres, goal = rng.normal(size=(50, d)), rng.normal(size=(2, 50, d)), np.ones(d)
    normals = tangents(path, centres, goal)
    assert np.linalg.norm(normals, axis=2) == pytest.approx(np.ones((2, 50)))
    straight = (path - centres) / np.linalg.norm(path - centres, axis=2, keepdims=True)
    turned = np.arccos(np.clip(np.sum(normals * straight, axis=2), -1.0, 1.0))
    assert turned.max() <= module.TILT + 1e-6
    towards = np.sum((normals - straight) * (goal - centres), axis=2)
    assert towards.min() >= -1e-9


# Flights


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("aside", [0.0, 1e-9, 0.1, -0.3])
def test_it_goes_round_an_obstacle_even_one_dead_in_line(
    d, aside, at_rest, fixed_world, no_neighbours
):
    own = at_rest([-2.0, aside, 0.0][:d], mass=12.0, max_force=0.6)
    obstacles = discs((np.zeros(d), np.zeros(d), 0.8), d=d)
    goal = np.array([2.0, 0.0, 0.0][:d])
    world = World(fixed_world(goal).goal, obstacles)
    track, state, _ = fly(mpc(MpcParams(), d), own, no_neighbours(d), world, 80.0)
    assert clearance(track, obstacles) > 0.04
    assert np.linalg.norm(track[-1] - goal) < 0.01
    assert list(state[:3]) == pytest.approx([0.0, 0.0, 0.0], abs=1e-3)


def test_it_lets_a_moving_neighbour_pass(at_rest, fixed_world):
    own, goal = at_rest([-2.0, 0.0], mass=12.0, max_force=0.6), np.array([2.0, 0.0])
    crossing = discs(((0.0, -1.6), (0.0, 0.08), 0.8))
    others = Neighbours(*crossing, np.array([1]), np.zeros((1, 0)), np.zeros(1))
    world = World(fixed_world(goal).goal, discs())
    track, state, _ = fly(mpc(MpcParams(), 2), own, others, world, 80.0)
    assert clearance(track, crossing) > 0.03
    assert np.linalg.norm(track[-1] - goal) < 0.01
    assert state[module.FAILED] == 0.0


def test_two_that_swap_places_pass_each_other(at_rest, fixed_world):
    law, period = mpc(MpcParams(), 2), 0.1
    bodies = [at_rest([-1.5, 0.0], 12.0, 0.6), at_rest([1.5, 0.0], 12.0, 0.6)]
    worlds = [World(fixed_world(goal).goal, discs()) for goal in ([1.5, 0.0], [-1.5, 0.0])]
    states, gaps = [None, None], []
    for k in range(900):
        seen, moved = list(bodies), []
        for i in range(2):
            them = discs((seen[1 - i].p, seen[1 - i].v, 0.8))
            others = Neighbours(*them, np.array([1 - i]), np.zeros((1, 0)), np.zeros(1))
            if states[i] is None:
                states[i] = law.initial(seen[i], others, worlds[i])
            ahead = law.propagate(states[i], seen[i], others, worlds[i], k * period, period, 1)
            states[i] = ahead.law_state
            moved.append(seen[i]._replace(p=ahead.p, v=ahead.v))
        bodies = moved
        gaps.append(np.linalg.norm(bodies[0].p - bodies[1].p))
    # each assumes that the other's velocity is constant, so the margin shrinks; there is no contact
    assert min(gaps) > 0.65
    assert {c.name for state in states for c in law.concerns(state)} <= {"margin-given-up"}
    assert bodies[0].p == pytest.approx([1.5, 0.0], abs=0.02)
    assert bodies[1].p == pytest.approx([-1.5, 0.0], abs=0.02)


def test_every_force_is_one_that_the_jets_have(at_rest, fixed_world, no_neighbours):
    own = at_rest([-2.5, 0.3], mass=12.0, max_force=0.2)
    law, others = mpc(MpcParams(), 2), no_neighbours(2)
    world = World(fixed_world([2.0, 0.0]).goal, discs(((0.0, 0.0), (0.0, 0.0), 0.8)))
    state, sizes = law.initial(own, others, world), []
    for k in range(300):
        ahead = law.propagate(state, own, others, world, 0.1 * k, 0.1, 1)
        state, own = ahead.law_state, own._replace(p=ahead.p, v=ahead.v)
        sizes.append(np.linalg.norm(ahead.mean_force))
    assert max(sizes) <= 0.2 * (1.0 + 1e-9)
    assert max(sizes) > 0.9 * 0.2  # and it uses them


def test_in_orbit_it_holds_a_goal_beside_a_debris(at_rest, fixed_world, no_neighbours):
    n, d, h = 1.1e-3, 3, 20.0
    goal = np.array([0.0, 200.0, 0.0])
    params = MpcParams(
        error=10.0, speed=0.5, accel=2e-3, steps=20, step_s=40.0, margin=2.0,
        feed="orbit", mean_motion=n,
    )  # fmt: skip
    obstacles = discs(((5.0, 0.0, 3.0), np.zeros(3), 50.0), d=3)
    law, world = mpc(params, d), World(fixed_world(goal).goal, obstacles)
    model = module.sampled(n, d, h)
    x, state, gaps = np.array([0.0, -200.0, 0.0, 0.0, 0.0, 0.0]), None, []
    for k in range(300):
        own = at_rest(x[:d], mass=100.0, max_force=0.5)._replace(v=x[d:])
        state = law.initial(own, no_neighbours(d), world) if state is None else state
        ahead = law.propagate(state, own, no_neighbours(d), world, k * h, h, 1)
        state, x = ahead.law_state, model.a @ x + model.b @ (ahead.mean_force / own.mass)
        gaps.append(np.linalg.norm(x[:d] - obstacles.p[0]))
    assert min(gaps) > 50.0
    assert x[:d] == pytest.approx(goal, abs=0.05)
    assert law.concerns(state) == []


# Without an offset


@pytest.mark.parametrize("remainder_s", [0.0, 5.0])
@pytest.mark.parametrize("d", [2, 3])
def test_a_disturbance_that_no_estimator_sees_leaves_no_offset(
    remainder_s, d, at_rest, fixed_world, no_neighbours
):
    own, unseen, gives = at_rest([0.3] * d, mass=12.0, max_force=0.6), np.zeros(d), 0.9
    unseen[0] = 4e-4  # [m/s^2]
    law, world = mpc(MpcParams(remainder_s=remainder_s), d), fixed_world([0.0] * d)
    state = law.initial(own, no_neighbours(d), world)
    for k in range(1500):
        ahead = law.propagate(state, own, no_neighbours(d), world, 0.1 * k, 0.1, 1)
        a = gives * ahead.mean_force / own.mass + unseen
        state = ahead.law_state
        own = own._replace(p=own.p + 0.1 * (own.v + 0.05 * a), v=own.v + 0.1 * a)
    gain = feedback(sampled(0.0, d, 1.0), weights(1.0, 0.1, 0.02, d))[0, 0]  # near the goal
    offset = 0.0 if remainder_s else 4e-4 / (gives * gain)  # 26 mm
    assert own.p[0] == pytest.approx(offset, abs=1e-5)
    assert own.v == pytest.approx(np.zeros(d), abs=1e-6)


def test_a_blocked_vehicle_does_not_add_up_more_than_a_share(at_rest, fixed_world, no_neighbours):
    own, law = at_rest([0.3, 0.0], mass=12.0, max_force=0.6), Mpc(MpcParams(), 2)
    state, world = law.initial(own, None, None), fixed_world([0.0, 0.0])
    for _ in range(2000):
        _, state = law.decide(state, own, no_neighbours(2), world, 0.1)
    assert np.linalg.norm(state[-4:-2]) == pytest.approx(module.LARGEST_REST * 0.6 / 12.0)


# When there is no way


def test_a_margin_that_cannot_be_kept_is_given_up_and_named(at_rest, fixed_world, no_neighbours):
    own = at_rest([0.3, 0.0], mass=12.0, max_force=0.6)  # begins half a metre inside
    obstacles = discs(((0.0, 0.0), (0.0, 0.0), 0.8))
    law, world = mpc(MpcParams(), 2), World(fixed_world([2.0, 0.0]).goal, obstacles)
    track, state, _ = fly(law, own, no_neighbours(2), world, 60.0)
    assert np.linalg.norm(track[-1] - [2.0, 0.0]) < 0.01
    (concern,) = law.concerns(state)
    assert concern.name == "margin-given-up"
    assert "0.5" in concern.text


def test_the_price_of_a_margin_is_exact(at_rest, fixed_world, no_neighbours):
    # a margin that can be kept is kept, whatever the goal would gain: here it lies inside
    own = at_rest([-2.0, 0.1], mass=12.0, max_force=0.6)
    obstacles = discs(((0.0, 0.0), (0.0, 0.0), 0.8))
    law, world = mpc(MpcParams(), 2), World(fixed_world([0.0, 0.0]).goal, obstacles)
    track, state, _ = fly(law, own, no_neighbours(2), world, 60.0)
    assert clearance(track, obstacles) >= 0.05 - 1e-3
    assert law.concerns(state) == []


def test_without_a_plan_it_brakes_and_says_so(monkeypatch, at_rest, fixed_world, no_neighbours):
    monkeypatch.setattr(module.daqp, "solve", lambda *a, **k: (np.zeros(40), 0.0, -4, {}))
    own = at_rest([-2.0, 0.0], mass=12.0, max_force=0.6)
    own = own._replace(v=np.array([0.08, -0.03]), disturbance=np.array([0.0, 1e-3]))
    law, world = mpc(MpcParams(), 2), fixed_world([2.0, 0.0])
    _, state, end = fly(law, own, no_neighbours(2), world, 10.0)
    assert end.v == pytest.approx([0.0, 0.0], abs=1e-6)
    (concern,) = law.concerns(state)
    assert concern.name == "solver-failed"
    assert "100 decisions" in concern.text


def test_numbers_beyond_measure_are_a_failure_and_no_crash(at_rest, fixed_world, no_neighbours):
    own, law = at_rest([np.nan, 0.0], mass=12.0, max_force=0.6), Mpc(MpcParams(), 2)
    force, state = law.decide(
        law.initial(own, None, None), own, no_neighbours(2), fixed_world([2.0, 0.0]), 0.1
    )
    assert state[module.FAILED] == 1.0
    assert np.isfinite(force).all()


# Sameness


def test_it_does_the_same_again(at_rest, fixed_world, no_neighbours):
    own = at_rest([-2.0, 0.1], mass=12.0, max_force=0.6)
    world = World(fixed_world([2.0, 0.0]).goal, discs(((0.0, 0.0), (0.0, 0.0), 0.8)))
    one, two = (fly(mpc(MpcParams(), 2), own, no_neighbours(2), world, 20.0) for _ in range(2))
    assert (one[0] == two[0]).all()
    assert (one[1] == two[1]).all()
    assert one[1].shape == (PLAN + 40 + 4,)
