"""The gradient of the potential and its rates against the potential itself.

The oracle is the corrected Eq. (14) alone, a product in its repulsive part. Its gradient comes from
complex steps, exact to rounding; derivatives in time from differences of that gradient along a
trajectory on which satellite, goal and obstacles all move.
"""

import math

import numpy as np
import pytest

from controllers.potential import PotentialParams, diagonal, gradient, potential
from testbed.core.law import Discs

PARAMS = PotentialParams(attract=(0.012, 0.02, 0.03), repel=(0.8, 0.6, 0.4), standoff=2.5)
SHAPES = [(2, 0), (2, 1), (3, 0), (3, 1), (3, 2)]  # dimensions, seed

# central differences of order 8: weights at -4 ... 4
FIRST = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
SECOND = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])
STEP = 0.02  # [s]


def eq14(params, p, goal, discs):
    """U of the corrected Eq. (14); `discs` are (centre, danger radius)."""
    e, d = p - goal, len(p)
    attract, repel = np.array(params.attract)[:d], np.array(params.repel)[:d]
    u = 0.5 * np.sum(attract * e * e)
    for centre, radius in discs:
        # width^2 = N sigma for the paper's radius, and in proportion for others
        grown = (radius + params.standoff) / params.design_radius
        width2 = params.spread * params.sigma * grown**2
        r = p - centre
        bump = params.height * np.exp(-np.sum(r * r) / width2)
        u = u + 0.5 * np.sum(repel * e * e) * bump
    return u


def gradient_of_eq14(params, p, goal, discs):
    tiny, d = 1e-30, len(p)
    return np.array(
        [eq14(params, p + 1j * tiny * axis, goal, discs).imag / tiny for axis in np.eye(d)]
    )


def moved(t, own, force, neighbours, world):
    """Position, goal and discs `t` later, when accelerations stay."""
    p = own.p + t * own.v + 0.5 * t * t * (force / own.mass + own.disturbance)
    goal = world.goal.p + t * world.goal.v + 0.5 * t * t * world.goal.a
    discs = [
        (centre + t * v, radius)
        for group in (world.obstacles, neighbours)
        for centre, v, radius in zip(*group[:3], strict=True)
    ]
    return p, goal, discs


def on_the_way(params, own, force, neighbours, world):
    """The oracle's gradient at nine instants around now."""
    times = STEP * np.arange(-4, 5)
    return np.array(
        [gradient_of_eq14(params, *moved(t, own, force, neighbours, world)) for t in times]
    )


def derivatives(u, own, *rest):
    """What `gradient` writes."""
    error, rows = np.empty((2, 3, len(own.p)))
    gradient(u, own, *rest, error, rows)
    return error, rows


@pytest.fixture(params=SHAPES, ids=lambda shape: f"{shape[0]}d-{shape[1]}")
def scene(request, random_scene):
    """(own, force, neighbours, world) and the rows that `gradient` gives for it."""
    d, seed = request.param
    own, neighbours, world = random_scene(seed, d, mass=2.0)
    force = 0.05 * np.random.default_rng(seed).normal(size=d)
    error, rows = derivatives(potential(PARAMS, d), own, force, neighbours, world)
    return (own, force, neighbours, world), error, rows


def test_gradient_is_that_of_eq14(scene):
    things, _, rows = scene
    expected = gradient_of_eq14(PARAMS, *moved(0.0, *things))
    assert rows[0] == pytest.approx(expected, rel=1e-12)


def test_omega_is_the_rate_of_the_gradient(scene):
    things, _, rows = scene
    expected = FIRST @ on_the_way(PARAMS, *things) / STEP
    assert rows[1] == pytest.approx(expected, rel=1e-8, abs=1e-8 * np.abs(expected).max())


def test_the_second_rate_of_the_gradient(scene):
    things, _, rows = scene
    expected = SECOND @ on_the_way(PARAMS, *things) / STEP**2
    assert rows[2] == pytest.approx(expected, rel=1e-6, abs=1e-6 * np.abs(expected).max())


def test_the_error_and_its_rates(scene):
    (own, force, _, world), error, _ = scene
    accel = force / 2.0 + own.disturbance
    expected = [own.p - world.goal.p, own.v - world.goal.v, accel - world.goal.a]
    assert error == pytest.approx(np.array(expected))


def test_the_scenes_feel_the_obstacles(scene):
    # or else the tests above would only look at the attractive part
    things, _, rows = scene
    far = moved(0.0, *things)
    alone = gradient_of_eq14(PARAMS, far[0], far[1], [])
    assert np.linalg.norm(rows[0]) > 10.0 * np.linalg.norm(alone)


def test_the_potential_is_zero_at_the_goal(random_scene):
    # the work from the goal to where the satellite is equals U there, so U(goal) = 0
    own, neighbours, world = random_scene(7, 3)
    world = world._replace(goal=world.goal._replace(p=own.p + np.array([15.0, -20.0, 10.0])))
    nodes, weights = np.polynomial.legendre.leggauss(60)
    way, u = own.p - world.goal.p, potential(PARAMS, 3)
    work = 0.0
    for s, weight in zip(0.5 + 0.5 * nodes, 0.5 * weights, strict=True):
        here = own._replace(p=world.goal.p + s * way)
        work += weight * derivatives(u, here, np.zeros(3), neighbours, world)[1][0] @ way
    _, goal, discs = moved(0.0, own, np.zeros(3), neighbours, world)
    assert work == pytest.approx(eq14(PARAMS, own.p, goal, discs), rel=1e-10)


@pytest.mark.parametrize("d", [2, 3])
def test_nothing_pulls_at_the_goal_not_even_inside_a_disc(d, random_scene):
    own, neighbours, world = random_scene(3, d)
    world = world._replace(goal=world.goal._replace(p=own.p, v=own.v))
    _, rows = derivatives(potential(PARAMS, d), own, np.zeros(d), neighbours, world)
    assert (rows[:2] == 0.0).all()


def test_obstacles_and_neighbours_repel_alike(random_scene):
    own, neighbours, world = random_scene(4, 2)
    swapped = world._replace(obstacles=Discs(*neighbours[:3]))
    u, force = potential(PARAMS, 2), np.ones(2)
    one = derivatives(u, own, force, neighbours, world)
    other = derivatives(u, own, force, world.obstacles, swapped)
    assert one[1] == pytest.approx(other[1], rel=1e-12)


def test_a_disc_of_the_papers_radius_has_the_papers_width():
    u = potential(PotentialParams(), 3)
    assert u.width_ratio * 50.0 == pytest.approx(math.sqrt(15.0 * 10.0))  # N sigma, Table 2


@pytest.mark.parametrize(("grown", "standoff"), [(52.5, 0.0), (50.0, 2.5)])
def test_standoff_is_as_good_as_a_larger_radius(grown, standoff, random_scene):
    own, neighbours, world = random_scene(5, 2)
    radii = np.full(3, grown)
    world = world._replace(obstacles=world.obstacles._replace(radius=radii))
    neighbours = neighbours._replace(p=neighbours.p + 1e6)
    u = potential(PotentialParams(standoff=standoff), 2)
    _, rows = derivatives(u, own, np.zeros(2), neighbours, world)
    discs = [(centre, 52.5) for centre in world.obstacles.p]
    expected = gradient_of_eq14(PotentialParams(attract=(0.012, 0.012)), own.p, world.goal.p, discs)
    assert rows[0] == pytest.approx(expected, rel=1e-12)


def test_diagonal_of_one_number_and_of_several():
    assert diagonal(0.5, 3).tolist() == [0.5, 0.5, 0.5]
    assert diagonal((1.0, 2.0, 3.0), 2).tolist() == [1.0, 2.0]
    with pytest.raises(ValueError, match="expected 3 diagonal elements"):
        diagonal((1.0, 2.0), 3)
