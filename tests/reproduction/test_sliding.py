"""How s, sigma and e of zhang2023 vanish: against closed forms and against the law itself."""

import numpy as np
import pytest

from controllers.sotsmc import SotsmcParams, sotsmc
from testbed.core.law import Body, Discs, Goal, Neighbours, World
from testbed.metrics.formation import settled_after
from testbed.reproduction.cluster import reached
from testbed.reproduction.sliding import Trajectory, decades, slope, surfaces

T = np.linspace(0.0, 60.0, 60_001)


def test_what_falls_exponentially_takes_the_same_for_every_decade():
    assert decades(T, 3.0 * np.exp(-T / 5.0), 1.0) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("share", [0.4, 1.0])
def test_what_falls_in_finite_time_takes_less_for_each(share):
    x = np.maximum(1.0 - T / 50.0, 0.0) ** (1.0 / share)  # x' = -c x^(1 - share)
    assert decades(T, x, 0.9) == pytest.approx(10.0**-share, rel=1e-2)


def test_what_never_gets_there_has_no_decades():
    assert decades(T, np.full(len(T), 0.5), 1.0) is None
    assert decades(T, 0.5 + 0.5 * np.sin(T), 10.0) is None


def test_for_good_and_for_the_first_time():
    t, off = np.arange(6.0), np.array([True, False, True, True, False, False])
    assert (reached(t, off), settled_after(t, off)) == (1.0, 4.0)
    assert (reached(t, ~off), settled_after(t, ~off)) == (0.0, None)
    assert reached(t, np.ones(6, dtype=bool)) is None


def motion(seed, gain=1.0):
    rng = np.random.default_rng(seed)
    p, v, a = (
        rng.normal(size=(1, 3)) * 40.0,
        rng.normal(size=(1, 3)),
        gain * rng.normal(size=(1, 3)),
    )
    obstacles = p + 20.0 * rng.normal(size=(2, 3))
    return Trajectory(np.zeros(1), p - 10.0, p, v, a, obstacles, 50.0)


@pytest.mark.parametrize("seed", range(10))
def test_s_and_sigma_are_those_of_the_law(seed):
    # with k = epsilon = 0 (28) is what keeps sigma where it is: its rate has no sigma in it; so
    # what k adds to u' is -k sigma
    way, still = motion(seed), np.zeros(3)
    _, sigma = surfaces(SotsmcParams(), way)
    own = Body(way.p[0], way.v[0], 1.0, way.a[0], still, np.inf, 0)  # u = 0: drift is all
    none = np.zeros((0, 3))
    others = Neighbours(
        none, none, np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros((0, 0)), np.zeros(0)
    )
    obstacles = Discs(way.obstacles, 0.0 * way.obstacles, np.full(2, way.radius))
    world = World(Goal(way.p[0] - way.e[0], still, still, still), obstacles)

    def change(k):
        law = sotsmc(SotsmcParams(k=k, epsilon=0.0), 3)
        return law.rate(np.zeros(4), own, others, world, 0.0)[1][:3]

    assert change(1.0) - change(2.0) == pytest.approx(sigma[0], rel=1e-5, abs=1e-6)


def test_the_gradient_is_that_of_the_potential():
    way, u = motion(3), sotsmc(SotsmcParams(), 3).gains.potential

    def height(p):
        e = p - (way.p[0] - way.e[0])
        r2 = ((p - way.obstacles) ** 2).sum(axis=1) / (u.width_ratio * way.radius) ** 2
        repulsion = (u.repel * e) @ e * (u.height * np.exp(-r2)).sum()
        return 0.5 * ((u.attract * e) @ e + repulsion)

    steps = 1e-4 * np.eye(3)
    numeric = [(height(way.p[0] + h) - height(way.p[0] - h)) / 2e-4 for h in steps]
    assert slope(u, way)[0] == pytest.approx(numeric, rel=1e-5)
