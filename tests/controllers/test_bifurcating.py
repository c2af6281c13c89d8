"""The bifurcating field, against its potentials written down once more, and in closed loop."""

import math

import msgspec
import numpy as np
import pytest

from controllers.bifurcating import BifurcatingParams, Phase, Wall, bifurcating
from controllers.bifurcating_design import Fleet
from controllers.catalogue import make_law
from controllers.scale import Scale
from testbed.core.law import Discs, silent

FLEET = Fleet(count=5, mass=15.0, force=1.0)
CIRCLE = {"a": 1.0, "b": 1.0, "r": 1.5, "mu": -3.0, "k_f": 1.1, "k_v": 7.0}
PLANAR = [
    CIRCLE,
    CIRCLE | {"mu": 0.4},
    CIRCLE | {"r": 0.0},
    CIRCLE | {"b": 0.6},
    CIRCLE | {"a": 1.5, "b": 1.0, "mu": 0.5},
    CIRCLE | {"b": 0.0},
    CIRCLE | {"b": 0.0, "mu": 0.75},
]
SURFACES = [
    CIRCLE | {"c": 1.0},
    CIRCLE | {"b": 0.8, "c": 0.6},
    CIRCLE | {"a": 1.2, "b": 0.8, "c": 0.6, "mu": 0.3, "r": 1.0},
]


def law_of(d, **numbers):
    return make_law(BifurcatingParams(phases=(Phase(**numbers),)), d=d)


def push(law, own, world, others, t=0.0):
    return law.rate(np.zeros(0), own, others, world, t)[0]


def around(centres):
    """Neighbours at rest."""
    p = np.array(centres, dtype=float)
    return silent(Discs(p, 0.0 * p, np.full(len(p), 0.4)))


def formation_potential(x, a, b, r, mu, k_f, sigma=0.0, c=None, **_):
    """Eqs. (22), (24) as printed; in the plane x is (x, z)."""
    if c is not None:
        rho = math.sqrt((b * c * x[0]) ** 2 + (a * c * x[1]) ** 2 + (a * b * x[2]) ** 2)
        rho -= a * b * c * r
    else:
        rho = math.hypot(b * x[0], a * x[-1]) - a * b * r
    across = sigma * x[1] ** 2 if len(x) == 3 and c is None else 0.0
    return k_f * (abs(rho) ** 3 / 3.0 - mu * rho**2 / 2.0 + across)


def slope(function, x, h=1e-5):
    """Gradient by central differences."""
    steps = h * np.eye(len(x))
    return np.array([(function(x + e) - function(x - e)) / (2.0 * h) for e in steps])


# The forces are gradients


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    ("d", "numbers"),
    [(2, n) for n in PLANAR]
    + [(3, n | {"sigma": 2.5}) for n in PLANAR]
    + [(3, n) for n in SURFACES],
)
def test_formation_force_is_the_slope_of_the_papers_potential(
    seed, d, numbers, at_rest, fixed_world, no_neighbours
):
    rng = np.random.default_rng(seed)
    centre, x = rng.normal(size=d), rng.uniform(-2.0, 2.0, d)
    force = push(law_of(d, **numbers), at_rest(centre + x), fixed_world(centre), no_neighbours(d))
    expected = -slope(lambda y: formation_potential(y, **numbers), x)
    assert force == pytest.approx(expected, rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("distance", [0.01, 0.5, 1.0, 1.99, 2.01, 5.0])
def test_repulsion_is_the_slope_of_the_corrected_potential(
    d, distance, at_rest, fixed_world, no_neighbours
):
    k_c, s = 0.8, 2.0
    p, rng = np.full(d, 0.3), np.random.default_rng(d)
    away = rng.normal(size=d)
    other = p - distance * away / np.linalg.norm(away)
    world, own = fixed_world(np.zeros(d)), at_rest(p)
    law = law_of(d, **CIRCLE, k_c=k_c, s=s)
    force = push(law, own, world, around([other])) - push(law, own, world, no_neighbours(d))

    def potential(x):
        gap = np.linalg.norm(x - other)
        return 0.5 * k_c * (s - gap) ** 2 if gap < s else 0.0

    assert force == pytest.approx(-slope(potential, p), abs=1e-5)
    assert force @ (p - other) >= 0.0  # away


@pytest.mark.parametrize(("d", "numbers"), [(2, n) for n in PLANAR] + [(3, n) for n in SURFACES])
def test_no_force_where_it_has_no_direction(d, numbers, at_rest, fixed_world):
    law, here = law_of(d, **numbers, k_c=1.0, s=2.0), np.full(d, 0.7)
    force = push(law, at_rest(here), fixed_world(here), around([here]))
    assert (force == 0.0).all()


def test_the_plane_holds_at_the_centre_too(at_rest, fixed_world, no_neighbours):
    law = law_of(3, **CIRCLE, sigma=2.0)
    force = push(law, at_rest([0.0, 0.1, 0.0]), fixed_world([0.0] * 3), no_neighbours(3))
    assert force == pytest.approx([0.0, -2.0 * 1.1 * 2.0 * 0.1, 0.0])


# Where formations are: Tables 1 and 2, corrected


def ellipse(a, b, mu=-3.0, r=1.0):
    return CIRCLE | {"a": a, "b": b, "r": r, "mu": mu}


ALONG_X, ALONG_Z = np.array([1.0, 0.0]), np.array([0.0, 1.0])
X, Y, Z = np.eye(3)
SEMI_AXES = [
    (CIRCLE, ALONG_X, [1.5]),
    (CIRCLE | {"mu": 0.4}, ALONG_X, [1.1, 1.9]),
    (ellipse(2.0, 0.6), ALONG_X, [2.0]),
    (ellipse(2.0, 0.6), ALONG_Z, [0.6]),
    (ellipse(1.5, 1.0, 0.5), ALONG_X, [1.0, 2.0]),  # ar -+ mu/b
    (ellipse(1.5, 1.0, 0.5), ALONG_Z, [2.0 / 3.0, 4.0 / 3.0]),  # br -+ mu/a; printed: 0.5, 1.5
    (ellipse(1.0, 0.5, 0.4), ALONG_X, [0.2, 1.8]),  # Fig. 9b; printed: 0.6, 1.4
    (ellipse(2.0, 0.0), ALONG_Z, [0.0]),
    (ellipse(2.0, 0.0, 0.75), ALONG_Z, [-0.375, 0.375]),  # +-mu/a
    (ellipse(1.2, 0.8) | {"c": 0.6}, X, [1.2]),
    (ellipse(1.2, 0.8) | {"c": 0.6}, Y, [0.8]),
    (ellipse(1.2, 0.8) | {"c": 0.6}, Z, [0.6]),
    (ellipse(1.2, 0.8, 0.1) | {"c": 0.6}, X, [1.2 - 0.1 / 0.48, 1.2 + 0.1 / 0.48]),  # ar -+ mu/bc
    (ellipse(1.2, 0.8, 0.1) | {"c": 0.6}, Y, [0.8 - 0.1 / 0.72, 0.8 + 0.1 / 0.72]),
    (ellipse(1.2, 0.8, 0.1) | {"c": 0.6}, Z, [0.6 - 0.1 / 0.96, 0.6 + 0.1 / 0.96]),
]


@pytest.mark.parametrize(("numbers", "axis", "places"), SEMI_AXES)
def test_formations_are_where_the_corrected_tables_say(
    numbers, axis, places, at_rest, fixed_world, no_neighbours
):
    d = len(axis)
    law, world = law_of(d, **numbers), fixed_world(np.zeros(d))
    for place in places:
        near = [
            push(law, at_rest((place + off) * axis), world, no_neighbours(d)) @ axis
            for off in (-1e-3, 0.0, 1e-3)
        ]
        assert near[1] == pytest.approx(0.0, abs=1e-9)
        assert near[0] > 1e-5
        assert near[2] < -1e-5


def test_an_exact_line_does_not_split_and_any_other_does(at_rest, fixed_world, no_neighbours):
    law, world = law_of(2, **ellipse(1.0, 0.0, 0.75)), fixed_world([0.0, 0.0])
    assert (push(law, at_rest([0.4, 0.0]), world, no_neighbours(2)) == 0.0).all()
    assert push(law, at_rest([0.4, 1e-6]), world, no_neighbours(2))[1] > 0.0


def ring(n, radius):
    angle = 2.0 * np.pi * np.arange(n) / n
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


KILOMETRES = {"kN": Scale(length=1e-3), "N": Scale(length=1e-3, mass=1e5)}
PAPER = {"a": 1.0, "b": 1.0, "r": 0.5, "mu": -5.0, "k_f": 3.0, "k_v": 2000.0, "k_c": 0.25, "s": 0.5}


@pytest.mark.parametrize("unit", KILOMETRES)
def test_fifty_satellites_make_a_ring_of_511_metres(unit, at_rest, fixed_world):
    # r = s = 0.5 km; an independent simulation of the motion gave 0.5111 km
    law = make_law(BifurcatingParams(phases=(Phase(**PAPER),), scale=KILOMETRES[unit]))

    def outward(radius):
        p = ring(50, radius)
        return push(law, at_rest(p[0], mass=100.0), fixed_world([0.0, 0.0]), around(p[1:]))[0]

    low, high = 400.0, 600.0
    while high - low > 1e-3:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if outward(middle) > 0.0 else (low, middle)
    assert low == pytest.approx(511.1, abs=0.3)

    gaps = 1e-3 * low * 2.0 * np.sin(np.pi * np.arange(1, 50) / 50)
    repulsion = 0.25 * np.clip(0.5 - gaps, 0.0, None) @ np.sin(np.pi * np.arange(1, 50) / 50)
    assert repulsion / (3.0 * 5.0) == pytest.approx(1e-3 * low - 0.5, rel=0.01)  # push/K


def test_both_readings_of_the_papers_force(at_rest, fixed_world, no_neighbours):
    # 0.2 km outside the circle: k_f (rho^2 - mu rho) = 3 (0.04 + 1) = 3.12 kN or N
    own = at_rest([700.0, 0.0], mass=100.0)
    for unit, newton in (("kN", 3120.0), ("N", 3.12)):
        law = make_law(BifurcatingParams(phases=(Phase(**PAPER),), scale=KILOMETRES[unit]))
        assert push(law, own, fixed_world([0.0, 0.0]), no_neighbours(2)) == pytest.approx(
            [-newton, 0.0]
        )


# What is wrong with the print


def as_printed_13(k_c, s, gap):
    d = np.linalg.norm(gap)
    return k_c * (1.0 - s / d) * gap if d <= s else 0.0 * gap


def printed_potential_12(k_c, s, gap):
    return -k_c * (gap @ gap - s * np.linalg.norm(gap))


def test_the_printed_force_is_the_other_way(at_rest, fixed_world):
    law, own, other = law_of(2, **CIRCLE, k_c=0.8, s=2.0), at_rest([1.5, 0.0]), [0.7, 0.4]
    force = push(law, own, fixed_world([0.0, 0.0]), around([other]))
    assert force == pytest.approx(-as_printed_13(0.8, 2.0, own.p - other))


def test_the_printed_potential_is_that_of_neither_sign():
    k_c, s, gap = 0.8, 2.0, np.array([0.5, 0.0])
    force = -slope(lambda x: printed_potential_12(k_c, s, x), gap)
    assert force == pytest.approx(k_c * (2.0 - s / 0.5) * gap)  # -1.6 x_ij, Eq. (13): -2.4 x_ij
    assert force[0] < 0.0  # it attracts below s/2
    assert (
        -slope(lambda x: printed_potential_12(k_c, s, x), 0.999 * s * gap / 0.5)[0] > 0.99 * k_c * s
    )


def fly_together(
    law, starts, seconds, at_rest, fixed_world, no_neighbours, *, repulsion=None, mass=15.0
):
    """All of them, each with what it knows of the others: positions (n, d), smallest gap [m].

    `repulsion` is added to the law's force; the others are then not told to the law.
    """
    p, h = np.array(starts, dtype=float), 0.02
    n, d = p.shape
    v, world, nearest = np.zeros((n, d)), fixed_world(np.zeros(d)), math.inf
    for k in range(round(seconds / h)):
        force = np.zeros((n, d))
        for i in range(n):
            others = np.delete(p, i, axis=0)
            own = at_rest(p[i], mass, 1.0)._replace(v=v[i])
            heard = around(others) if n > 1 and repulsion is None else no_neighbours(d)
            force[i] = push(law, own, world, heard, k * h)
            if repulsion is not None:
                force[i] += sum(repulsion(p[i] - other) for other in others)
        v = v + h * force / mass
        p = p + h * v
        if n > 1:
            gaps = np.linalg.norm(p[:, None] - p[None], axis=2)
            nearest = min(nearest, gaps[np.triu_indices(n, 1)].min())
    return p, nearest


def starts_of(seed, n, d=2):
    rng = np.random.default_rng(seed)
    while True:
        p = rng.uniform(-2.2, 2.2, (n, d))
        gaps = np.linalg.norm(p[:, None] - p[None], axis=2)[np.triu_indices(n, 1)]
        if gaps.min(initial=math.inf) > 0.8:
            return p


def designed(*shapes, fleet=FLEET, **more):
    phases = tuple(Phase(at=75.0 * k, shape=shape) for k, shape in enumerate(shapes))
    return bifurcating(BifurcatingParams(phases=phases, fleet=fleet, **more), 2)


def test_with_the_printed_force_the_cluster_collapses(at_rest, fixed_world, no_neighbours):
    numbers = BifurcatingParams(phases=(Phase(shape="circle"),), fleet=FLEET)
    field = numbers.field(numbers.phases[0])
    starts, scene = starts_of(4, 5), (at_rest, fixed_world, no_neighbours)

    def printed(gap):
        return as_printed_13(field.k_c, field.s, gap)

    _, nearest = fly_together(designed("circle"), starts, 75.0, *scene, repulsion=printed)
    assert nearest < 0.05
    _, nearest = fly_together(designed("circle"), starts, 75.0, *scene)
    assert nearest > 0.55


# Closed loop


@pytest.mark.parametrize(("seed", "n"), [(0, 5), (1, 5), (2, 4), (3, 3)])
def test_a_circle_forms_evenly_spaced(seed, n, at_rest, fixed_world, no_neighbours):
    law = designed("circle", fleet=Fleet(n, 15.0, 1.0))
    p, nearest = fly_together(law, starts_of(seed, n), 75.0, at_rest, fixed_world, no_neighbours)
    assert np.hypot(*p.T) == pytest.approx(np.full(n, 1.5), abs=0.01)
    angles = np.sort(np.arctan2(p[:, 1], p[:, 0]))
    turns = np.diff(np.append(angles, angles[0] + 2.0 * np.pi))
    assert turns == pytest.approx(np.full(n, 2.0 * np.pi / n), abs=0.05)
    assert nearest > 0.55


@pytest.mark.parametrize("start", [[0.3, -0.1], [-2.4, 2.0]])
def test_one_alone_goes_to_the_nearest_point_of_the_circle(
    start, at_rest, fixed_world, no_neighbours
):
    law = designed("circle", fleet=Fleet(1, 15.0, 1.0))
    p, _ = fly_together(law, [start], 60.0, at_rest, fixed_world, no_neighbours)
    assert p[0] == pytest.approx(1.5 * np.array(start) / math.hypot(*start), abs=1e-3)


def test_four_in_space_make_a_tetrahedron_on_a_sphere(at_rest, fixed_world, no_neighbours):
    law = law_of(3, **(CIRCLE | {"c": 1.0}), k_c=0.5, s=2.9)
    p, _ = fly_together(law, starts_of(0, 4, 3), 120.0, at_rest, fixed_world, no_neighbours)
    radii = np.linalg.norm(p, axis=1)
    assert radii == pytest.approx(np.full(4, radii[0]), abs=0.01)
    assert radii[0] == pytest.approx(1.5, abs=0.15)  # the repulsion widens it
    gaps = np.linalg.norm(p[:, None] - p[None], axis=2)[np.triu_indices(4, 1)]
    assert gaps == pytest.approx(np.full(6, radii[0] * math.sqrt(8.0 / 3.0)), abs=0.02)


def test_a_planar_formation_in_space_stays_in_its_plane(at_rest, fixed_world, no_neighbours):
    law = law_of(3, **CIRCLE, k_c=0.5, s=1.9, sigma=2.0)
    p, _ = fly_together(law, starts_of(1, 4, 3), 90.0, at_rest, fixed_world, no_neighbours)
    assert np.abs(p[:, 1]).max() < 0.01
    assert np.hypot(p[:, 0], p[:, 2]) == pytest.approx(np.full(4, 1.5), abs=0.1)


def test_phases_follow_each_other(at_rest, fixed_world, no_neighbours):
    law, scene = designed("line", "double_line"), (at_rest, fixed_world, no_neighbours)
    wall = designed("line", "double_line", wall=Wall(at=2.55, stiffness=8.0))
    start = starts_of(5, 5)
    p, _ = fly_together(wall, start, 75.0, *scene)
    assert np.abs(p[:, 1]).max() < 0.01
    p, _ = fly_together(wall, start, 150.0, *scene)
    assert np.abs(p[:, 1]) == pytest.approx(np.full(5, 0.75), abs=0.05)
    assert len(set(np.sign(p[:, 1]))) == 2
    assert np.abs(p[:, 0]).max() < 2.7
    p, _ = fly_together(law, start, 75.0, *scene)  # a line is free along itself
    assert np.abs(p[:, 1]).max() < 0.01


# What is ours


@pytest.mark.parametrize(
    ("t", "shape"), [(0.0, "circle"), (74.9, "circle"), (75.0, "line"), (1e4, "ellipse")]
)
def test_the_field_switches_at_the_phases_times(t, shape, at_rest, fixed_world):
    all_three, alone = designed("circle", "line", "ellipse"), designed(shape)
    own, others = at_rest([0.3, 0.2], 15.0), around([[0.9, 0.4]])
    world = fixed_world([0.0, 0.0])
    assert (push(all_three, own, world, others, t) == push(alone, own, world, others)).all()


def test_the_formation_force_is_cut_and_the_whole_force_bounded(
    at_rest, fixed_world, no_neighbours
):
    far, world = [30.0, 40.0], fixed_world([0.0, 0.0])
    force = push(designed("circle"), at_rest(far, 15.0), world, no_neighbours(2))
    assert force == pytest.approx(-0.8 * np.array([0.6, 0.8]))
    crowd = around([[30.0, 40.1], [30.1, 40.0]])
    force = push(designed("circle"), at_rest(far, 15.0, 1.0), world, crowd)
    assert np.linalg.norm(force) == pytest.approx(1.0)


def test_velocity_is_relative_to_the_centre_which_may_accelerate(
    at_rest, fixed_world, no_neighbours
):
    law, world = law_of(2, **CIRCLE), fixed_world([0.0, 0.0])
    v, a = np.array([7560.0, 10.0]), np.array([0.2, -8.0])  # an orbit's, Eq. (10) as printed
    moving = world._replace(goal=world.goal._replace(v=v, a=a))
    own = at_rest([1.1, 0.4], 15.0)
    still = push(law, own, world, no_neighbours(2))
    assert push(law, own._replace(v=v), moving, no_neighbours(2)) == pytest.approx(still + 15.0 * a)
    slow = push(law, own._replace(v=np.array([0.1, 0.0])), world, no_neighbours(2))
    assert slow - still == pytest.approx([-0.7, 0.0])


def test_drift_is_cancelled(at_rest, fixed_world, no_neighbours):
    law, world, own = law_of(2, **CIRCLE), fixed_world([0.0, 0.0]), at_rest([1.1, 0.4], 15.0)
    tilted = own._replace(disturbance=np.array([2e-3, -1e-3]))
    change = push(law, tilted, world, no_neighbours(2)) - push(law, own, world, no_neighbours(2))
    assert change == pytest.approx([-0.03, 0.015])


def test_a_centre_of_its_own_takes_the_place_of_the_goal(at_rest, fixed_world, no_neighbours):
    numbers = BifurcatingParams(phases=(Phase(**CIRCLE),), centre=(0.4, -0.2))
    own, others = at_rest([1.1, 0.4]), no_neighbours(2)
    force = push(bifurcating(numbers, 2), own, fixed_world([9.0, 9.0]), others)
    assert (force == push(law_of(2, **CIRCLE), own, fixed_world([0.4, -0.2]), others)).all()


def test_the_wall_is_a_spring_beyond_its_place(at_rest, fixed_world, no_neighbours):
    free, walled = designed("line"), designed("line", wall=Wall(at=2.55, stiffness=8.0))
    world, others = fixed_world([0.0, 0.0]), no_neighbours(2)
    for p, spring in (
        ([2.5, -2.5], [0.0, 0.0]),
        ([2.65, 0.0], [-0.8, 0.0]),
        ([-2.6, 2.8], [0.4, -2.0]),
    ):
        own = at_rest(p, 15.0)
        change = push(walled, own, world, others) - push(free, own, world, others)
        assert change == pytest.approx(spring, abs=1e-9)


# Bad input


@pytest.mark.parametrize(
    ("numbers", "complaint"),
    [
        ({"phases": []}, "at least one phase"),
        ({"phases": [{"at": 1.0, **CIRCLE}]}, "a first phase at 0 s, found 1 s"),
        ({"phases": [CIRCLE, {"at": 5.0, **CIRCLE}, {"at": 5.0, **CIRCLE}]}, "found 5 s after 5 s"),
        ({"phases": [{"a": 1.0, "b": 1.0}]}, "a shape or mu, k_f, k_v"),
        ({"phases": [{"shape": "circle"}]}, "expected `fleet`"),
        ({"phases": [{"shape": "square"}]}, "square"),
        ({"phases": [CIRCLE | {"k_f": 0.0}]}, "k_f"),
        ({"phases": [CIRCLE | {"n": 5}]}, "`n`"),
        ({"phases": [CIRCLE], "fleet": {"count": 0, "mass": 1.0, "force": 1.0}}, "count"),
    ],
)
def test_bad_parameters_are_refused(numbers, complaint):
    with pytest.raises(msgspec.ValidationError, match=complaint):
        msgspec.convert({"type": "bifurcating", **numbers}, BifurcatingParams)


@pytest.mark.parametrize(
    ("d", "numbers", "complaint"),
    [
        (2, {"phases": (Phase(**CIRCLE, c=1.0),)}, "expected no c"),
        (4, {"phases": (Phase(**CIRCLE),)}, "expected 2 or 3 dimensions, found 4"),
        (3, {"phases": (Phase(**CIRCLE),), "centre": (0.0, 0.0)}, "a centre of 3 coordinates"),
        (2, {"phases": (Phase(shape="line"),), "fleet": Fleet(20, 15.0, 1.0)}, "room for 20"),
    ],
)
def test_what_cannot_be_flown_is_refused(d, numbers, complaint):
    with pytest.raises(ValueError, match=complaint):
        make_law(BifurcatingParams(**numbers), d=d)


def test_given_numbers_take_the_place_of_the_recipes():
    numbers = BifurcatingParams(phases=(Phase(shape="circle", k_c=0.5),), fleet=FLEET)
    plain = BifurcatingParams(phases=(Phase(shape="circle"),), fleet=FLEET)
    one, other = numbers.field(numbers.phases[0]), plain.field(plain.phases[0])
    assert one == msgspec.structs.replace(other, k_c=0.5)
