"""The safety filter: nothing is hit whatever a law wants, and nothing is changed without need."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace
from scipy.optimize import minimize

from testbed.core.table import Obstacle
from testbed.flight.barrier import (
    Barrier,
    BarrierParams,
    Limits,
    discs_of,
    filtered,
    reaches,
    speed_left,
)
from testbed.flight.half_planes import nearest, yielding

PARAMS = BarrierParams()
MASS, FORCE, PERIOD = 12.5, 1.14, 0.1  # the shipped vehicle: [kg], [N], [s]
DECEL, HARD = PARAMS.effort * FORCE / MASS, FORCE / MASS
LIMITS = Limits(
    MASS, FORCE, DECEL, HARD, PERIOD, PERIOD + PARAMS.reaction_s, PARAMS.max_speed, 2.78, 2.78
)
TOUCH = 0.4  # [m] centre to centre
KEEP = TOUCH + PARAMS.vehicle_margin

angles = st.floats(0.0, 2.0 * math.pi)
half_planes = st.lists(st.tuples(angles, st.floats(-1.0, 2.0)), min_size=1, max_size=6)
forces = st.floats(-3.0, 3.0)


def rows(planes):
    return np.array([(math.cos(a), math.sin(a), h, 0.0) for a, h in planes])


# The nearest force


@given(planes=half_planes, fx=forces, fy=forces)
def test_the_nearest_force_is_that_of_a_general_solver(planes, fx, fy):
    table = rows(planes)
    found, x, y = nearest(fx, fy, table, len(table), FORCE, 0.0)
    if not found:
        return
    assert np.hypot(x, y) <= FORCE * (1.0 + 1e-6)
    assert (table[:, 0] * x + table[:, 1] * y <= table[:, 2] + 1e-6).all()
    oracle = minimize(
        lambda u: (u[0] - fx) ** 2 + (u[1] - fy) ** 2,
        (x, y),
        jac=lambda u: 2.0 * (u - (fx, fy)),
        method="SLSQP",
        constraints=[
            {"type": "ineq", "fun": lambda u: FORCE**2 - u @ u, "jac": lambda u: -2.0 * u},
            {"type": "ineq", "fun": lambda u: table[:, 2] - table[:, :2] @ u,
             "jac": lambda u: -table[:, :2]},
        ],
    )  # fmt: skip
    gone = (x - fx) ** 2 + (y - fy) ** 2
    kept = (table[:, :2] @ oracle.x <= table[:, 2] + 1e-6).all() and oracle.x @ oracle.x <= (
        FORCE * (1.0 + 1e-6)
    ) ** 2
    assert not kept or gone <= oracle.fun + 1e-5


@given(planes=half_planes, fx=forces, fy=forces)
def test_it_is_found_if_there_is_one(planes, fx, fy):
    table = rows(planes)
    found, *_ = nearest(fx, fy, table, len(table), FORCE, 0.0)
    angle, size = np.meshgrid(np.linspace(0.0, 2.0 * math.pi, 60), np.linspace(0.0, FORCE, 20))
    tried = np.column_stack(((size * np.cos(angle)).ravel(), (size * np.sin(angle)).ravel()))
    possible = (tried @ table[:, :2].T <= table[:, 2]).all(axis=1).any()
    assert found or not possible


@given(planes=half_planes, fx=forces, fy=forces)
def test_when_nothing_is_left_all_give_way_by_the_least(planes, fx, fy):
    table = rows(planes)
    x, y = yielding(fx, fy, table, len(table), FORCE)
    over = float((table[:, :2] @ (x, y) - table[:, 2]).max())
    assert np.hypot(x, y) <= FORCE * (1.0 + 1e-6)
    if over > 1e-6:
        assert not nearest(fx, fy, table, len(table), FORCE, 0.99 * over - 1e-7)[0]


# Speed


@given(gap=st.floats(0.0, 3.0), closing=st.floats(0.0, 0.3))
def test_the_speed_that_is_left_can_be_stopped_in_the_gap(gap, closing):
    slow = LIMITS.slow
    left = speed_left(gap, closing, closing, DECEL, HARD, slow)
    gone = 0.5 * slow * (closing + max(left, 0.0))
    if left > 0.0:
        assert gone + left**2 / (2.0 * DECEL) <= gap + 1e-9


def test_deep_inside_it_backs_out_slowly():
    assert speed_left(-1.0, 0.0, 0.0, DECEL, HARD, 0.3) == -0.02
    assert speed_left(-0.01, 0.0, 0.0, DECEL, HARD, 0.3) == pytest.approx(-0.005)


# One vehicle


def use(force, place, velocity, discs=(), bias=(0.0, 0.0), limits=LIMITS, strength=1.0):
    return filtered(*force, *place, *velocity, *bias, discs_of(discs, HARD), limits, strength)


def test_far_from_everything_the_demand_is_untouched():
    assert use((0.7, -0.3), (0.0, 0.0), (0.05, 0.0))[:3] == (0.7, -0.3, -1)


def test_also_one_that_is_more_than_the_jets_can_do():
    assert use((9.0, 9.0), (0.0, 0.0), (0.0, 0.0))[:3] == (9.0, 9.0, -1)


@pytest.mark.parametrize(
    ("place", "velocity", "hazard"),
    [
        ((2.7, 0.0), (0.1, 0.0), 0), ((-2.7, 0.0), (-0.1, 0.0), 1),
        ((0.0, 2.7), (0.0, 0.1), 2), ((0.0, -2.7), (0.0, -0.1), 3), ((0.0, 0.0), (0.25, 0.0), 4),
    ],
)  # fmt: skip
def test_what_it_keeps_away_from_is_named(place, velocity, hazard):
    force = tuple(5.0 * v for v in velocity)
    x, y, named, _ = use(force, place, velocity)
    assert named == hazard
    assert np.hypot(x, y) <= FORCE + 1e-9
    assert x * velocity[0] + y * velocity[1] < force[0] * velocity[0] + force[1] * velocity[1]


def test_only_the_part_towards_the_hazard_is_changed():
    x, y, hazard, _ = use((0.5, 0.3), (2.7799, 0.0), (0.0, 0.0))
    assert hazard == 0
    assert x < 0.5
    assert y == pytest.approx(0.3)


def test_spare_room_is_what_a_full_stop_leaves():
    rock = (1.0, 0.0, 0.0, 0.0, 0.8, 1.0)
    *_, spare = use((0.0, 0.0), (0.0, 0.0), (0.1, 0.0), [rock])
    assert spare == pytest.approx(0.2 - 0.1**2 / (2.0 * HARD))
    *_, none = use((0.0, 0.0), (0.0, 0.0), (0.0, 0.0), [rock])
    assert none == math.inf  # nothing is ahead of what stands


@pytest.mark.parametrize("other", [0.1, 0.5, 1.0, 2.0, 10.0])
@pytest.mark.parametrize("gap", [0.05, 0.3, 1.0])
def test_unlike_vehicles_that_close_in_as_their_filters_allow_have_room(other, gap):
    """Each filter lets its vehicle use half of the gap, at half of what its jets can do."""
    theirs = other * HARD
    mine, its = (math.sqrt(0.5 * gap * hard) for hard in (HARD, theirs))
    for share, has_room in ((0.99, True), (1.01, False)):
        other_vehicle = (KEEP + gap, 0.0, -share * its, 0.0, KEEP, 0.5)
        discs = discs_of([other_vehicle], theirs)
        spare = filtered(0.0, 0.0, 0.0, 0.0, share * mine, 0.0, 0.0, 0.0, discs, LIMITS, 1.0)[3]
        assert (spare >= 0.0) == has_room


def test_spare_room_does_not_count_an_obstacle_that_moves():
    # a stop is no remedy against it: `escape` looks after it
    rock = (1.0, 0.0, -0.1, 0.0, 0.8, 1.0)
    *_, spare = use((0.0, 0.0), (0.0, 0.0), (0.1, 0.0), [rock])
    _, _, _, alone = use((0.0, 0.0), (0.0, 0.0), (0.1, 0.0), [])
    assert spare == alone


def test_a_demand_that_is_no_number_is_left_to_the_watch():
    x, _, hazard, _ = use((math.nan, 0.0), (0.0, 0.0), (0.0, 0.0))
    assert math.isnan(x)
    assert hazard == -1


# In flight


def simulate(seed, vehicles, obstacles, wants, seconds=40.0, strength=1.0):
    """Vehicles under the filter, with noise, latency of what is heard, and jets that are not true.

    `wants(rng, i, t, p, v)` is the law of vehicle i: a force within the jets'. Of that the jets
    give the share `strength`.

    Returns:
        smallest room to the fence, to the danger radii and between two rims [m].
    """
    rng = np.random.default_rng(seed)
    p, v = np.array(vehicles, dtype=float), np.zeros((len(vehicles), 2))
    kept = [(*rock, PARAMS.obstacle_margin) for rock in obstacles]
    discs = [(x, y, 0.0, 0.0, radius + margin, 1.0) for x, y, radius, margin in kept]
    gain = 1.0 + 0.05 * rng.standard_normal((len(vehicles), 1))
    bias = 2e-3 * rng.standard_normal((len(vehicles), 2))
    past, room = [], [math.inf] * 3
    for k in range(round(seconds / PERIOD)):
        past.append((p.copy(), v.copy()))
        force = np.zeros_like(p)
        for i in range(len(p)):
            late = int(rng.integers(1, 4))  # [periods]
            old_p, old_v = past[max(0, len(past) - 1 - late)]
            seen = old_p + late * PERIOD * old_v
            others = [(*seen[j], *old_v[j], KEEP, 0.5) for j in range(len(p)) if j != i]
            place = p[i] + 3e-4 * rng.standard_normal(2)
            velocity = v[i] + 1.5e-3 * rng.standard_normal(2)
            wanted = strength * np.array(wants(rng, i, k * PERIOD, p, v))
            rocks = [*discs, *others]
            force[i] = use(wanted, place, velocity, rocks, bias[i], strength=strength)[:2]
        noisy = gain + 0.03 * rng.standard_normal((len(p), 1))
        a = force * noisy / MASS + bias + 5e-4 * rng.standard_normal(p.shape)
        p, v = p + PERIOD * (v + 0.5 * PERIOD * a), v + PERIOD * a
        room[0] = min(room[0], 2.8 - np.abs(p).max())
        for x, y, radius in obstacles:
            room[1] = min(room[1], np.hypot(*(p - (x, y)).T).min() - radius)
        for i in range(len(p)):
            for j in range(i):
                room[2] = min(room[2], np.hypot(*(p[i] - p[j])) - TOUCH)
    return room


def layout(rng, vehicles):
    """Obstacles and places that keep their distances at the start."""
    obstacles = [
        (*rng.uniform(-2.2, 2.2, 2), rng.uniform(0.4, 0.8)) for _ in range(rng.integers(0, 4))
    ]
    places = []
    while len(places) < vehicles:
        place = rng.uniform(-2.75, 2.75, 2)
        clear = all(np.hypot(*(place - rock[:2])) > rock[2] + 0.01 for rock in obstacles)
        if clear and all(np.hypot(*(place - other)) > KEEP for other in places):
            places.append(place)
    return places, obstacles


class Adversaries:
    """Laws that chase another, fly at an obstacle, change their mind, or shake, at full thrust."""

    def __init__(self, rng, vehicles, obstacles):
        self._kind = rng.integers(0, 4, vehicles)
        self._aim = (*obstacles[0][:2],) if obstacles else (3.0, 3.0)
        self._last = np.zeros((vehicles, 2))

    def __call__(self, rng, i, t, p, v):
        if rng.random() < 0.01:
            self._kind[i] = rng.integers(0, 4)
        match self._kind[i]:
            case 0:
                wanted = p[(i + 1) % len(p)] - p[i]
            case 1:
                wanted = np.array(self._aim) - p[i]
            case 2:
                wanted = rng.standard_normal(2) if rng.random() < 0.05 else self._last[i]
            case _:
                wanted = rng.uniform(-1.0, 1.0, 2)
        self._last[i] = wanted
        size = np.hypot(*wanted)
        return FORCE * wanted / size if size > 0.0 else wanted


@pytest.mark.parametrize("batch", range(10))
def test_no_adversary_hits_anything(batch):
    # 10 x 29 runs of 2, 3, 4 and 5 vehicles: 1000 laws and some
    for seed in range(1000 * batch, 1000 * batch + 29):
        rng = np.random.default_rng(seed)
        vehicles = 2 + seed % 4
        places, obstacles = layout(rng, vehicles)
        edge, rock, pair = simulate(seed, places, obstacles, Adversaries(rng, vehicles, obstacles))
        assert edge > 0.0, seed
        assert rock > 0.0, seed
        assert pair > 0.0, seed


@pytest.mark.parametrize("strength", [0.4, 0.7])
def test_nor_with_a_jet_less_or_little_pressure(strength):
    for seed in range(2000, 2029):
        rng = np.random.default_rng(seed)
        places, obstacles = layout(rng, 2 + seed % 4)
        laws = Adversaries(rng, len(places), obstacles)
        room = simulate(seed, places, obstacles, laws, seconds=60.0, strength=strength)
        assert min(room) > 0.0, (seed, room)


@pytest.mark.parametrize("strength", [1.0, 0.5, 0.25])
def test_a_weak_vehicle_stops_before_the_edge(strength):
    push = (FORCE / np.sqrt(2.0), FORCE / np.sqrt(2.0))
    edge, *_ = simulate(1, [(0.0, 0.3)], [], lambda *_: push, strength=strength)
    assert 0.0 < edge < 0.2


@pytest.mark.parametrize("slope", [0.0, 0.2, 0.33])
@pytest.mark.parametrize("weak", [0.75, 1.0])
def test_a_slope_towards_the_edge_and_weak_jets_leave_room_for_a_stop(slope, weak):
    """`slope` is the share of the jets' force that it takes, `weak` what they give of it."""
    x, v, bias, spare = 0.0, 0.0, slope * HARD, math.inf
    for _ in range(600):
        fx, _, _, room = use((FORCE, 0.0), (x, 0.0), (v, 0.0), (), (bias, 0.0))
        spare = min(spare, room)
        a = weak * fx / MASS + slope * HARD
        bias += 0.1 * (a - fx / MASS - bias)  # what the estimator learns in a second
        x, v = x + PERIOD * (v + 0.5 * PERIOD * a), v + PERIOD * a
    assert spare > -0.01  # the row `too_near`
    assert LIMITS.half_x - 0.3 < x < LIMITS.half_x + 0.01


@pytest.mark.parametrize("up", [-0.24, 0.0, 0.3])
def test_a_slope_that_leaves_enough_changes_no_plan(up):
    """`up` is the slope's share of the jets' force, away from the lower edge."""
    _, y, hazard, _ = use((0.0, -FORCE), (0.0, -2.5), (0.0, -0.15), (), (0.0, up * HARD))
    left = speed_left(0.28, 0.15, 0.15, DECEL, HARD, LIMITS.slow)
    assert hazard == 3
    assert y == pytest.approx(-MASS * ((left - 0.15) / PERIOD + up * HARD))


def test_a_law_that_flies_straight_at_an_obstacle_is_stopped_short_of_it():
    room = simulate(0, [(-2.0, 0.01)], [(0.5, 0.0, 0.8)], lambda *_: (FORCE, 0.0))
    assert 0.0 < room[1] < 0.1


def test_two_that_fly_at_each_other_stop_apart():
    room = simulate(
        0,
        [(-2.0, 0.0), (2.0, 0.0)],
        [],
        lambda rng, i, *_: (FORCE, 0.0) if i == 0 else (-FORCE, 0.0),
    )
    assert 0.0 < room[2] < 0.2


def test_one_at_rest_is_not_run_over():
    room = simulate(
        0, [(-2.0, 0.0), (2.0, 0.0)], [], lambda rng, i, *_: (FORCE, 0.0) if i == 0 else (0.0, 0.0)
    )
    assert 0.0 < room[2] < 0.2


# The object


ROCKS = {
    "o1": Obstacle((-1.0, 0.0), 0.8, 0.3),
    "o2": Obstacle((2.0, 0.0), 0.5, 0.3, velocity=(-0.05, 0.0)),
}


@pytest.fixture
def barrier():
    return Barrier(PARAMS, MASS, FORCE, PERIOD, (2.8, 2.8), ROCKS, {"b": TOUCH, "c": TOUCH})


STILL = (0.0, 0.0, 0.0, 0.0)


def test_an_untouched_demand_is_given_back_as_it_is(barrier):
    assert barrier.filter(0.0, (0.3, 0.2), (0.5, 0.0, *STILL), {}) == (0.3, 0.2, None)


def test_a_moving_obstacle_is_where_it_is_now(barrier):
    at = (0.9, 0.0, *STILL)
    assert barrier.filter(0.0, (0.3, 0.0), at, {})[2] is None
    late = barrier.filter(11.0, (0.3, 0.0), at, {})[2]
    assert late.words == "o2"
    assert late.dfx_w < 0.0


@pytest.mark.parametrize(
    ("other", "place"), [("b", (0.5, 0.4601, 0.0)), ("c", (0.5, -0.4601, 0.0))]
)
def test_neighbours_are_named(barrier, make_state, other, place):
    far = {"b": make_state((2.5, 2.5, 0.0), t=1.0), "c": make_state((2.5, -2.5, 0.0), t=1.0)}
    heard = far | {other: make_state(place, t=1.0)}
    change = barrier.filter(1.0, (0.0, 1.0 * np.sign(place[1])), (0.5, 0.0, *STILL), heard)[2]
    assert change.words == other


def test_a_neighbour_that_is_not_heard_any_more_is_given_more_room(barrier, make_state):
    demand, at = (0.0, 0.3), (0.5, 0.0, *STILL)
    fresh = {"b": make_state((0.5, 0.465, 0.0), t=0.0)}
    x, y, _ = barrier.filter(0.1, demand, at, fresh)
    _, less, _ = barrier.filter(2.0, demand, at, fresh)
    assert less < y <= demand[1]
    assert x == pytest.approx(0.0, abs=1e-6)


def test_with_little_pressure_less_is_planned(barrier):
    full = barrier.filter(0.0, (1.0, 0.0), (2.75, 0.0, 0.1, 0.0, 0.0, 0.0), {})
    weak = barrier.filter(0.0, (1.0, 0.0), (2.75, 0.0, 0.1, 0.0, 0.0, 0.0), {}, thrust_scale=0.5)
    assert abs(weak[0]) <= 0.5 * FORCE + 1e-9
    assert full[0] == pytest.approx(-FORCE)


def test_with_little_pressure_a_stop_begins_earlier(barrier):
    motion = (2.3, 2.0, 0.16, 0.0, 0.0, 0.0)
    full = barrier.filter(0.0, (0.3, 0.0), motion, {})
    weak = barrier.filter(0.0, (0.3, 0.0), motion, {}, thrust_scale=0.5)
    assert full[0] == pytest.approx(0.3)
    assert weak[0] < -0.3


def test_reaches_are_of_the_others():
    assert reaches({"a": 0.2, "b": 0.3}, "a") == {"b": pytest.approx(0.5)}


def test_a_margin_moves_what_is_kept():
    wide = replace(PARAMS, obstacle_margin=0.5)
    near = Barrier(wide, MASS, FORCE, PERIOD, (2.8, 2.8), ROCKS, {})
    assert near.filter(0.0, (-0.3, 0.0), (0.2, 0.0, *STILL), {})[2].words == "o1"
