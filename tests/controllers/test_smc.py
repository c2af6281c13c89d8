"""First-order SMC: Eq. (44) at single points, and how it compares with SOTSMC in zhang2023."""

import numpy as np
import pytest

from controllers.potential import gradient, potential
from controllers.smc import SmcParams, smc
from controllers.sotsmc import SotsmcParams, sotsmc
from testbed.core.law import World

PAPER = SmcParams()


def eq44(params, own, neighbours, world):
    """The force of Eq. (44) with the goal's acceleration for the misprinted r_d."""
    d = len(own.p)
    e, g = np.empty((2, 3, d))
    gradient(potential(params.potential, d), own, np.zeros(d), neighbours, world, e, g)
    k = np.array(params.k)[:d]
    e_dot = own.v - world.goal.v
    s = k * g[0] + e_dot
    reach = params.lambda_1 * s + params.lambda_2 * np.sign(s) * np.sqrt(np.abs(s))
    return own.mass * (-k * g[1] - reach - own.disturbance + world.goal.a)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("seed", range(10))
def test_force_is_eq44(d, seed, random_scene):
    own, neighbours, world = random_scene(seed, d, mass=2.0)
    force, change = smc(PAPER, d).rate(np.zeros(0), own, neighbours, world, 0.0)
    assert force == pytest.approx(eq44(PAPER, own, neighbours, world), rel=1e-12)
    assert len(change) == 0


@pytest.mark.parametrize("alpha", [0.25, 1.0])
def test_alpha_is_the_exponent_of_the_reaching_law(alpha, at_rest, fixed_world, no_neighbours):
    own, world = at_rest([-8.0, 2.0]), fixed_world([0.0, 0.0])
    params = SmcParams(k=1.0, lambda_1=1e-12, lambda_2=0.7, alpha=alpha)
    force, _ = smc(params, 2).rate(np.zeros(0), own, no_neighbours(2), world, 0.0)
    s = 0.012 * np.abs(own.p)
    assert force == pytest.approx([0.7 * s[0] ** alpha, -0.7 * s[1] ** alpha], rel=1e-9)


@pytest.mark.parametrize("centres", [[], [[1.0, 0.0]]])
def test_equilibrium_at_the_goal(centres, at_rest, fixed_world, no_neighbours):
    own, world = at_rest([1.0, 2.0]), fixed_world([1.0, 2.0], centres)
    force, _ = smc(PAPER, 2).rate(np.zeros(0), own, no_neighbours(2), world, 0.0)
    assert (force == 0.0).all()


def test_on_the_surface_it_only_cancels_what_is_known(random_scene, no_neighbours, no_discs):
    # s = 0 where e' = -k nabla U: the rest of the force keeps it there
    own, _, world = random_scene(1, 3, mass=3.0)
    world = World(world.goal, no_discs(3))
    k = np.array(PAPER.k)
    own = own._replace(v=world.goal.v - k * 0.012 * (own.p - world.goal.p))
    force, _ = smc(PAPER, 3).rate(np.zeros(0), own, no_neighbours(3), world, 0.0)
    s_dot = k * 0.012 * (own.v - world.goal.v) + force / 3.0 + own.disturbance - world.goal.a
    assert s_dot == pytest.approx(np.zeros(3), abs=1e-6)  # |s| is 1e-17, and its root 3e-9


@pytest.mark.parametrize("limit", [0.001, 0.5])
def test_force_is_bounded_and_keeps_its_direction(limit, random_scene):
    own, neighbours, world = random_scene(2, 2)
    law = smc(PAPER, 2)
    free, _ = law.rate(np.zeros(0), own, neighbours, world, 0.0)
    short, _ = law.rate(np.zeros(0), own._replace(max_force=limit), neighbours, world, 0.0)
    assert np.linalg.norm(free) > limit
    assert short == pytest.approx(limit * free / np.linalg.norm(free), rel=1e-12)


def fly_sat1(law, at_rest, fixed_world, no_neighbours):
    """Sat1 of Table 1 for 3000 s, undisturbed: position error (n,), peak control per axis."""
    own = at_rest([-200.0, 200.0, 100.0])
    goal = np.array([0.0, 50.0, 0.0])
    world = fixed_world(goal, [[-130.0, 180.0, 75.0], [-80.0, 70.0, 30.0]])
    state, error, peak = law.initial(own, no_neighbours(3), world), [], 0.0
    for k in range(30_000):
        state, p, v, force, _ = law.propagate(state, own, no_neighbours(3), world, 0.1 * k, 0.1, 5)
        own = own._replace(p=p, v=v)
        error.append(np.linalg.norm(p - goal))
        peak = max(peak, np.abs(force).max())
    return np.array(error), peak


def test_paper_the_baseline_peaks_higher_and_lasts_longer(at_rest, fixed_world, no_neighbours):
    # "the output of the controller increases significantly ...", Figs. 9, 10
    slow, high = fly_sat1(smc(PAPER, 3), at_rest, fixed_world, no_neighbours)
    fast, low = fly_sat1(sotsmc(SotsmcParams(), 3), at_rest, fixed_world, no_neighbours)
    assert fast[10_000] < 0.1
    assert slow[10_000] > 10.0 * fast[10_000]
    assert high > 2.0 * low
    assert slow[-1] < 0.1  # it does arrive
