"""A vehicle leaves the path of a moving obstacle in time, and makes room for one that must."""

import numpy as np
import pytest

from testbed.core.table import Obstacle
from testbed.core.types import Accel, Pose, State, Twist
from testbed.flight.barrier import WIDTH, Barrier, BarrierParams, discs_of, filtered, guarded
from testbed.flight.escape import GIVE_WAY, reached_in, right_of_way

PARAMS = BarrierParams()
MASS, FORCE, PERIOD = 12.5, 1.14, 0.1  # the shipped vehicle: [kg], [N], [s]
HALF = 2.0  # of the places of its centre [m]
TOUCH = 0.4  # [m] centre to centre
RADIUS, BODY = 0.6, 0.05  # danger radius, and how much of it is air beside the body [m]

# obstacles that end at the fence, and vehicles between; a filter that only brakes loses them all
TRAPPED = {
    "against the fence": ((0.0, 0.0), (0.08, 0.0), (1.9, 0.0)),
    "in a corner": ((0.0, 0.0), (0.06, 0.06), (1.9, 1.8)),
    "along the fence": ((-2.5, 1.7), (0.1, 0.0), (0.5, 1.95)),
    # the way out passes before the obstacle: a filter that brakes it there loses the vehicle
    "between fence and obstacle": ((1.27, -0.62), (0.022, -0.07), (1.95, -0.99)),
}


def rows(*obstacles):
    kept = RADIUS + PARAMS.obstacle_margin
    return discs_of([(*place, *velocity, kept, 1.0) for place, velocity in obstacles])


def room(force_of, place, velocity, start, seconds=40.0):
    """Smallest room to the obstacle's danger radius and to the fence [m]."""
    p, v, least = np.array(start), np.zeros(2), np.inf
    for k in range(round(seconds / PERIOD)):
        t = k * PERIOD
        # the law wants to meet the obstacle
        wish = np.array(place) + t * np.array(velocity) - p
        wish *= FORCE / max(np.hypot(*wish), 1e-9)
        a = np.array(force_of(t, wish, p, v)) / MASS
        p, v = p + PERIOD * (v + 0.5 * PERIOD * a), v + PERIOD * a
        far = np.hypot(*(p - place - (t + PERIOD) * np.array(velocity)))
        least = min(least, far - RADIUS, HALF - np.abs(p).max())
    return least


@pytest.fixture(scope="module", params=TRAPPED)
def trap(request):
    return TRAPPED[request.param]


def test_a_vehicle_in_the_path_of_an_obstacle_leaves_it(trap):
    place, velocity, _ = trap
    rock = Obstacle(place, RADIUS, RADIUS - 0.2 - BODY, velocity)
    barrier = Barrier(PARAMS, MASS, FORCE, PERIOD, (HALF, HALF), {"o1": rock}, {})
    named = set()

    def force_of(t, wish, p, v):
        fx, fy, change = barrier.filter(t, tuple(wish), (*p, *v, 0.0, 0.0), {})
        named.add(change.words if change else "")
        return fx, fy

    assert room(force_of, *trap) > 0.0
    assert "o1" in named


def test_half_planes_alone_would_lose_it(trap):
    place, velocity, _ = trap
    limits = Barrier(PARAMS, MASS, FORCE, PERIOD, (HALF, HALF), {}, {}).limits
    disc = rows((place, velocity))

    def force_of(t, wish, p, v):
        now = disc.copy()
        now[:, :2] += t * disc[:, 2:4]
        return filtered(*wish, *p, *v, 0.0, 0.0, now, limits, 1.0)[:2]

    assert room(force_of, *trap) < 0.0


def test_the_time_until_an_obstacle_reaches_a_place():
    discs = rows(((-1.0, 0.0), (0.1, 0.0)), ((0.0, 5.0), (0.0, 0.0)))
    ahead, which = reached_in(0.5, 0.0, discs)
    assert which == 0
    assert ahead == pytest.approx((1.5 - RADIUS) / 0.1, abs=1.2)  # NARROW earlier
    assert reached_in(0.5, 2.0, discs) == (np.inf, -1)  # beside its path
    assert reached_in(-2.5, 0.0, discs) == (np.inf, -1)  # behind it


def test_the_vehicle_that_is_reached_first_has_the_right_of_way():
    rock = (-1.0, 0.0, 0.1, 0.0, RADIUS, 1.0)
    near, far = (0.2, 0.0), (0.8, 0.0)
    seen_by_far = discs_of([rock, (*near, 0.0, 0.0, 0.46, 0.5)])
    seen_by_near = discs_of([rock, (*far, 0.0, 0.0, 0.46, 0.5)])
    assert right_of_way(*far, seen_by_far)[:, 0].tolist() == [0.0, GIVE_WAY]
    assert right_of_way(*near, seen_by_near)[:, 0].tolist() == [0.0, 0.0]


@pytest.mark.parametrize(("far", "within"), [(1.2, 5.0), (0.95, 2.5), (0.6, 1.5)])
def test_room_has_to_be_made_before_the_neighbour_is_reached(far, within):
    rock = (-far, 0.0, 0.1, 0.0, RADIUS, 1.0)
    seen = discs_of([rock, (0.0, 0.0, 0.0, 0.0, 0.46, 0.5)])
    assert right_of_way(1.0, 0.0, seen)[1, 1] == pytest.approx(within, abs=0.1)


@pytest.mark.parametrize("wish", [(0.7, 0.0), (0.7, 0.3), (0.0, 0.0)])
def test_room_is_made_and_not_promised_again_and_again(wish):
    """An obstacle carries a vehicle into a corner, and another one is in the only way out."""
    rock = Obstacle((1.826, 1.088), 0.7214, 0.4714, (0.0403, 0.0697))
    half, names = 2.405, ("carried", "other")
    filters = {
        name: Barrier(PARAMS, MASS, FORCE, PERIOD, (half, half), {"o1": rock}, {other: TOUCH})
        for name, other in (names, names[::-1])
    }
    p = {"carried": np.array([2.354, 1.635]), "other": np.array([1.87, 1.87])}
    v = {"carried": np.array([0.0, 0.04]), "other": np.array([0.04, 0.03])}
    least = np.inf
    for k in range(150):
        t = k * PERIOD
        states = {
            name: State(t, Pose(*p[name], 0.0), Twist(*v[name], 0.0), Accel(0.0, 0.0, 0.0), 0.0, 0)
            for name in names
        }
        for name, other in (names, names[::-1]):
            motion, demand = (*p[name], *v[name], 0.0, 0.0), wish if name == "other" else (0.0, 0.0)
            fx, fy, _ = filters[name].filter(t, demand, motion, {other: states[other]})
            a = np.array((fx, fy)) / MASS
            p[name] += PERIOD * (v[name] + 0.5 * PERIOD * a)
            v[name] += PERIOD * a
        place = np.array(rock.position) + (t + PERIOD) * np.array(rock.velocity)
        for name in names:
            far = np.hypot(*(p[name] - place)) - rock.radius
            least = min(least, far, half - np.abs(p[name]).max())
    assert least > -0.2 * BODY


@pytest.mark.parametrize(("gap", "counts"), [(0.02, False), (1.5, True)])
def test_a_vehicle_without_a_way_out_is_not_stopped_in_front_of_the_obstacle(gap, counts):
    """It drifts into the margin of what stands; behind it, an obstacle comes out of the middle."""
    kept, fence = RADIUS + PARAMS.obstacle_margin, 0.1
    limits = Barrier(PARAMS, MASS, FORCE, PERIOD, (HALF, fence + PARAMS.edge_margin), {}, {}).limits
    rocks = discs_of([
        (-kept, 0.0, 0.0, 0.0, kept, 1.0), (kept + gap, 0.0, -0.1, 0.0, kept, 1.0),
    ])  # fmt: skip
    spare = guarded(
        0.0, 0.0, 0.0, -0.015, 0.0, -0.03, 0.0, 0.0, 0.0, rocks, np.empty((0, WIDTH)), limits, 1.0
    )[3]
    assert (spare < 0.0) == counts
