"""The recipe for a table gives the numbers that were worked out apart from it."""

import numpy as np
import pytest

from controllers.bifurcating_design import Fleet, cruise, design, distance_to
from testbed.config import find, load
from testbed.flight.guidance import weakest_force

# N, mass, force, shape: k_c, k_f, k_v, s, mu, a, b, r; r of a line does not matter
ROWS = [
    (5, 15.0, 1.0, "circle", 0.812, 1.067, 6.93, 2.028, -3.0, 1.0, 1.0, 1.421),
    (5, 15.0, 1.0, "line", 2.182, 1.067, 6.93, 1.10, -3.0, 1.0, 0.0, None),
    (5, 15.0, 1.0, "double_line", 1.333, 4.267, 6.93, 1.45, 0.75, 1.0, 0.0, None),
    (5, 15.0, 1.0, "ellipse", 0.932, 1.778, 6.93, 1.838, -3.0, 1.0, 0.6, 2.0),
    (3, 15.0, 1.0, "circle", 0.492, 1.067, 6.93, 2.988, -3.0, 1.0, 1.0, 1.396),
    (3, 15.0, 1.0, "ellipse", 0.876, 1.778, 6.93, 1.92, -3.0, 1.0, 0.6, 2.0),
    (8, 15.0, 1.0, "circle", 1.558, 1.067, 6.93, 1.320, -3.0, 1.0, 1.0, 1.436),
    (8, 15.0, 1.0, "line", 4.511, 1.067, 6.93, 0.816, -3.0, 1.0, 0.0, None),
    (8, 15.0, 1.0, "ellipse", 2.004, 1.778, 6.93, 1.149, -3.0, 1.0, 0.6, 2.0),
    (5, 20.0, 0.4, "circle", 0.325, 0.427, 5.06, 2.028, -3.0, 1.0, 1.0, 1.421),
    (5, 20.0, 0.4, "line", 0.873, 0.427, 5.06, 1.10, -3.0, 1.0, 0.0, None),
    (5, 20.0, 0.4, "double_line", 0.533, 1.707, 5.06, 1.45, 0.75, 1.0, 0.0, None),
    (5, 20.0, 0.4, "ellipse", 0.373, 0.711, 5.06, 1.838, -3.0, 1.0, 0.6, 2.0),
    (5, 10.0, 2.0, "circle", 1.624, 3.793, 10.67, 2.028, -3.0, 1.0, 1.0, 1.456),
    (5, 10.0, 2.0, "line", 4.364, 3.793, 10.67, 1.10, -3.0, 1.0, 0.0, None),
    (5, 10.0, 2.0, "double_line", 2.667, 15.17, 10.67, 1.45, 0.75, 1.0, 0.0, None),
    (5, 10.0, 2.0, "ellipse", 1.863, 6.321, 10.67, 1.838, -3.0, 1.0, 0.6, 2.0),
]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row[0]}-{row[1]:g}kg-{row[3]}")
def test_gains_of_each_shape_follow_from_the_fleet(row):
    n, mass, force, shape, k_c, k_f, k_v, s, mu, a, b, r = row
    field = design(Fleet(n, mass, force), shape)
    found = (field.k_c, field.k_f, field.k_v, field.s)
    assert found == pytest.approx((k_c, k_f, k_v, s), rel=1.5e-3)
    assert (field.mu, field.a, field.b) == (mu, a, b)
    assert r is None or field.r == pytest.approx(r, abs=1e-3)
    assert field.cap == pytest.approx(0.8 * force)


@pytest.mark.parametrize(
    ("mass", "force", "speed"), [(15.0, 1.0, 0.1155), (20.0, 0.4, 0.0632), (10.0, 2.0, 0.15)]
)
def test_cruising_speed(mass, force, speed):
    assert cruise(Fleet(5, mass, force)) == pytest.approx(speed, abs=1e-4)


def test_a_flat_ellipse_for_a_crowd():
    # worked out apart: s = 1.128, for a perimeter that is 2.7 % shorter than it is
    field = design(Fleet(8, 15.0, 1.0), "flat")
    assert (field.a, field.b, field.r, field.mu) == (1.0, 0.3, 2.35, -3.0)
    assert field.k_f == pytest.approx(3.556, rel=1e-3)
    assert field.s == pytest.approx(1.128, rel=0.03)
    angle = np.linspace(0.0, 2.0 * np.pi, 100_001)
    curve = np.stack([2.35 * np.cos(angle), 0.705 * np.sin(angle)])
    length = np.hypot(*np.diff(curve)).sum()
    assert field.s == pytest.approx(0.9 * length / 8, rel=1e-4)


@pytest.mark.parametrize("shape", ["circle", "line", "ellipse", "flat"])
def test_a_vehicle_on_its_own_needs_no_repulsion_on_circle_and_line(shape):
    field = design(Fleet(1, 15.0, 1.0), shape)
    assert np.isfinite([field.k_c, field.k_f, field.s, field.r]).all()
    if shape in ("circle", "line"):
        assert (field.k_c, field.s) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("shape", "p", "distance"),
    [
        ("circle", [0.0, 1.2], 0.3),
        ("line", [2.0, -0.4], 0.4),
        ("double_line", [1.0, -0.9], 0.15),
        ("double_line", [1.0, 0.0], 0.75),
        ("ellipse", [2.3, 0.0], 0.3),
        ("ellipse", [0.0, -1.0], 0.2),
        ("ellipse", [0.0, 0.0], 1.2),
        ("flat", [2.35, 0.0], 0.0),
    ],
)
def test_distance_to_a_curve(shape, p, distance):
    assert distance_to(shape, np.array(p)) == pytest.approx(distance, abs=1e-3)


def test_distance_to_an_ellipse_along_its_normal():
    angle = np.linspace(0.1, 6.2, 17)
    on = np.stack([2.0 * np.cos(angle), 1.2 * np.sin(angle)], axis=1)
    normal = np.stack([1.2 * np.cos(angle), 2.0 * np.sin(angle)], axis=1)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    assert distance_to("ellipse", on + 0.1 * normal) == pytest.approx(np.full(17, 0.1), abs=1e-3)


def test_the_shipped_fields_are_designed_for_the_vehicles_that_fly_them():
    experiment = load(find("gao2022_table"))
    fleet = experiment.controller.fleet
    assert fleet.count == len(experiment.vehicles)
    for setup in experiment.vehicles.values():
        assert setup.model.mass == fleet.mass
        assert weakest_force(setup.model) == pytest.approx(fleet.force)


def at_rest_on(field, fleet, seed, seconds, h=0.02):
    """Where vehicles come to rest on a planar field, written out in full: (places, pushes)."""
    rng, n = np.random.default_rng(seed), fleet.count
    angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, n))
    p = np.column_stack((1.6 * np.cos(angle), np.sin(angle))) + rng.normal(0.0, 0.1, (n, 2))
    v, weight, level = 0.0 * p, np.array([field.b**2, field.a**2]), field.a * field.b * field.r
    for _ in range(round(seconds / h)):
        q = np.sqrt(p**2 @ weight)
        rho = q - level
        force = -(field.k_f * (rho * np.abs(rho) - field.mu * rho) / q)[:, None] * weight * p
        force *= np.minimum(1.0, field.cap / np.linalg.norm(force, axis=1, keepdims=True))
        apart = p[:, None] - p[None]
        gap = np.linalg.norm(apart, axis=2) + 10.0 * np.eye(n)
        push = (
            np.where(gap < field.s, field.k_c * (field.s / gap - 1.0), 0.0)[..., None] * apart
        ).sum(1)
        v = v + h * (force + push - field.k_v * v) / fleet.mass
        p = p + h * v
    return p, push


@pytest.mark.parametrize("count", [3, 5])
def test_an_ellipse_needs_no_correction_for_repulsion(count):
    # there is room for all outside each other's range, so the push fades; 75 s are short for it
    fleet = Fleet(count=count, mass=15.0, force=1.0)
    field = design(fleet, "ellipse")
    places, push = at_rest_on(field, fleet, 1, 300.0)
    assert np.abs(push).max() < 0.01
    assert distance_to("ellipse", places).max() < 0.004
