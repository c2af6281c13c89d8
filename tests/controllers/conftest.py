"""Scenes for laws, in the paper's units, and hypothesis without chance and without a clock."""

import numpy as np
import pytest
from hypothesis import settings

from testbed.core.law import Body, Discs, Goal, World, silent

settings.register_profile("seeded", derandomize=True, deadline=None)
settings.load_profile("seeded")


@pytest.fixture(scope="session")
def no_discs():
    """Empty surroundings in `d` dimensions."""
    return lambda d: Discs(np.zeros((0, d)), np.zeros((0, d)), np.zeros(0))


@pytest.fixture(scope="session")
def no_neighbours(no_discs):
    """No neighbours in `d` dimensions."""
    return lambda d: silent(no_discs(d))


@pytest.fixture(scope="session")
def at_rest():
    """A satellite at rest at `p`, nothing pushes it."""

    def make(p, mass=1.0, max_force=1e9):
        p = np.array(p, dtype=float)
        still = np.zeros(len(p))
        return Body(p, still, mass, still, still, max_force)

    return make


@pytest.fixture(scope="session")
def fixed_world(no_discs):
    """A goal that stands still among discs of 50 m that do, too."""

    def make(goal, centres=()):
        goal = np.array(goal, dtype=float)
        still, d = np.zeros(len(goal)), len(goal)
        p = np.array(centres, dtype=float).reshape(-1, d)
        return World(Goal(goal, still, still, still), Discs(p, 0.0 * p, np.full(len(p), 50.0)))

    return make


@pytest.fixture(scope="session")
def random_scene():
    """Satellite, neighbours and world, everything moving; the discs are near enough to matter."""

    def make(seed, d, mass=1.0):
        rng = np.random.default_rng(seed)
        p = rng.uniform(-100.0, 100.0, d)

        def vector(scale):
            return scale * rng.normal(size=d)

        def discs(n):
            centres = p + 10.0 * rng.normal(size=(n, d))
            return Discs(centres, rng.normal(size=(n, d)), rng.uniform(30.0, 70.0, n))

        own = Body(p, vector(1.0), mass, vector(0.01), vector(1e-4), 1e9)
        goal = Goal(p + vector(100.0), vector(0.5), vector(0.02), vector(1e-3))
        return own, silent(discs(2)), World(goal, discs(3))

    return make
