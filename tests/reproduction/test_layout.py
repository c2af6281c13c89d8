"""Even formations: spacing, densities, and L where it has a closed form."""

import numpy as np
import pytest

from testbed.metrics.characterisation import characterise
from testbed.reproduction.layout import (
    cuts,
    densest,
    double_circle,
    ellipse,
    lattice,
    rested,
    spiral,
    spirals,
    turns,
)


def gaps(x):
    d = np.linalg.norm(x[:, None] - x[None], axis=2)
    return d[np.triu_indices(len(x), 1)]


@pytest.mark.parametrize(("a", "b"), [(1.0, 1.0), (1.0, 0.6)])
def test_an_ellipse_has_equal_arcs(a, b):
    x = ellipse(2000, a, b)
    assert (x[:, 0] / a) ** 2 + (x[:, 1] / b) ** 2 == pytest.approx(np.ones(2000), abs=1e-8)
    steps = np.linalg.norm(np.diff(x, axis=0), axis=1)
    assert np.ptp(steps) < 1e-3 * steps.mean()


def test_the_ring_of_50_is_a_regular_polygon():
    half = np.sin(np.pi / 50)
    exact = 50 * (half / (1.0 + half)) ** 3  # M = (2 r + 2 m)/2: opposite ones exist
    assert characterise(ellipse(50, 1.0, 1.0)).uniformity == pytest.approx(exact, rel=1e-6)


def test_both_circles_have_the_same_spacing():
    x = double_circle(50, 0.4, 1.0)
    radii = np.linalg.norm(x, axis=1)
    few = int(np.sum(radii < 0.7))
    assert few == 14
    assert 2.0 * np.pi * 0.4 / few == pytest.approx(2.0 * np.pi / (50 - few), rel=0.05)


@pytest.mark.parametrize(("d", "neighbours"), [(2, 6), (3, 12)])
def test_the_lattice_is_the_densest(d, neighbours):
    points, _ = lattice(d)
    distance = np.linalg.norm(points, axis=1)
    assert np.sum(np.abs(distance - 1.0) < 1e-9) == neighbours
    assert distance[distance > 1e-9].min() == pytest.approx(1.0)


def test_cuts_hold_as_many_as_asked_for_and_nothing_outside():
    axes = np.array([1.0, 0.6])
    found = list(cuts(50, axes))
    assert found
    for x in found:
        assert len(x) == 50
        assert gaps(x).min() == pytest.approx(1.0)
        inside = ((x / axes) ** 2).sum(axis=1).max()
        lattice_again = len(x) * np.sqrt(0.75) / (np.pi * 0.6 * inside)
        assert lattice_again == pytest.approx(1.0, abs=0.2)  # its density


@pytest.mark.parametrize("d", [2, 3])
def test_the_lattice_is_turned_and_not_bent(d):
    found = list(turns(d))
    assert found[0] == pytest.approx(np.eye(d))
    for turn in found:
        assert turn @ turn.T == pytest.approx(np.eye(d))
        assert np.linalg.det(turn) == pytest.approx(1.0)


def test_a_turned_lattice_fills_an_ellipsoid_better_than_one_along_its_axes():
    assert densest(50, (1.0, 0.8, 0.6)) == pytest.approx(0.3719, abs=1e-4)  # along the axes 0.305


def test_balls_never_fill_more_than_kepler_allows():
    assert densest(50, (1.0, 1.0, 1.0)) < np.pi / np.sqrt(18.0)


def test_a_spiral_is_on_its_surface_and_spread_evenly():
    x = spiral(50)
    assert np.linalg.norm(x, axis=1) == pytest.approx(np.ones(50))
    assert x.mean(axis=0) == pytest.approx(np.zeros(3), abs=0.02)
    axes = np.array([1.0, 0.8, 0.6])
    for y in spirals(50, (1.0, 0.8, 0.6)):
        assert ((y / axes) ** 2).sum(axis=1) == pytest.approx(np.ones(50))


def test_points_that_push_each_other_keep_further_apart():
    x = rested(50, (1.0, 1.0, 1.0))
    assert np.linalg.norm(x, axis=1) == pytest.approx(np.ones(50))
    assert gaps(x).min() > 0.46  # the best known arrangement of 50 has 0.5135 (Tammes)
    assert gaps(x).min() > gaps(spiral(50)).min()
