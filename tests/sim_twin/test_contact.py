"""Touches: when they happen, how often they count, and what leaning on something does."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from testbed.core.table import Obstacle

RADIUS = 0.2  # of the shipped vehicle [m]
WALL = 3.0 - RADIUS  # where its centre is when it touches an edge of the shipped table [m]


def at(x, y, vx=0.0, vy=0.0, omega=0.0):
    return [x, y, 0.0, vx, vy, omega]


def first_touch(offset, velocity, reach):
    """When two discs meet that are `offset` apart and approach with `velocity`; closed form."""
    a, b = velocity @ velocity, offset @ velocity
    return (-b - np.sqrt(b * b - a * (offset @ offset - reach**2))) / a


@settings(deadline=None, max_examples=100)
@given(
    bearing=st.floats(-np.pi, np.pi),
    speed=st.floats(0.02, 1.0),
    shared=st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05)),
    miss=st.floats(-0.38, 0.38),  # distance between the centres' paths; 0.4 touches nothing
    apart=st.floats(0.5, 1.2),
    window=st.floats(0.05, 10.0),
)
def test_two_discs_touch_when_geometry_says(
    make_vehicle, make_table, make_plant, bearing, speed, shared, miss, apart, window
):
    along = np.array([np.cos(bearing), np.sin(bearing)])
    offset = apart * along + miss * np.array([-along[1], along[0]])  # of the second from the first
    velocity, shared = -speed * along, np.array(shared)
    when = first_touch(offset, velocity, 2 * RADIUS)
    states = [at(*(-0.5 * offset), *shared), at(*(0.5 * offset), *(shared + velocity))]
    plant = make_plant([make_vehicle()] * 2, states, make_table(size=(99.0, 99.0)))
    while plant.t < when + 0.1:
        plant.advance(plant.t + window)
    touch = plant.touches[0]
    assert {touch.vehicle, touch.other} == {"0", "1"}
    assert touch.t == pytest.approx(when, abs=1e-9)


def test_who_flies_past_touches_nothing(make_vehicle, make_plant):
    plant = make_plant([make_vehicle()] * 2, [at(-1, 0, 0.4), at(1, 2 * RADIUS + 1e-6, -0.4)])
    plant.advance(6.0)
    assert plant.touches == []
    assert_allclose(plant.x[:, 3:], [[0.4, 0, 0], [-0.4, 0, 0]], atol=1e-15)


def test_a_moving_obstacle_is_met_on_its_way(make_vehicle, make_plant):
    rock = Obstacle(position=(1.0, 0.5), radius=0.6, solid=0.3, velocity=(-0.1, -0.05))
    plant = make_plant([make_vehicle()], [at(0, 0, 0.02)], obstacles={"rock": rock})
    plant.advance(10.0)
    when = first_touch(np.array([1.0, 0.5]), np.array([-0.12, -0.05]), 0.3 + RADIUS)
    assert plant.touches[0].t == pytest.approx(when, abs=1e-9)
    assert plant.touches[0].other == "rock"


def test_a_danger_zone_with_nothing_in_it_is_no_obstacle(make_vehicle, make_plant):
    zone = Obstacle(position=(0.0, 0.0), radius=0.6)
    plant = make_plant([make_vehicle()], [at(-1, 0, 0.5)], obstacles={"zone": zone})
    plant.advance(4.0)
    assert plant.touches == []


# Counting


def test_a_visit_to_an_edge_is_one_touch(make_vehicle, make_table, make_plant):
    table = make_table(restitution=0.1, tilt={"uniform": (0.05, 0.0)})
    plant = make_plant([make_vehicle()], [at(WALL - 0.1, 0)], table)
    for k in range(100):  # the bounces die away
        plant.advance(0.1 * (k + 1))
    assert [touch.other for touch in plant.touches] == ["right edge"]
    assert plant.touches[0].t == pytest.approx(2.0, abs=1e-9)
    assert plant.touches[0].speed == pytest.approx(0.1, abs=1e-9)


def test_every_visit_counts(make_vehicle, make_table, make_plant):
    plant = make_plant([make_vehicle()], [at(0, 0, 1.0)], make_table(restitution=1.0))
    for k in range(150):
        plant.advance(0.1 * (k + 1))
    width = 2 * WALL
    assert_allclose([touch.t for touch in plant.touches], [WALL, WALL + width, WALL + 2 * width])
    assert [touch.other.split()[0] for touch in plant.touches] == ["right", "left", "right"]
    assert plant.x[0, 3] == pytest.approx(-1.0, abs=1e-12)


# Leaning

PUSH = 0.1  # [m/s^2], as much as two jets of the shipped vehicle
LOOKS = np.arange(0.0371, 5.0, 0.0371)  # in no rhythm with the plant's steps [s]


@pytest.mark.parametrize("com", [(0.0, 0.0), (0.03, -0.02)])
def test_a_vehicle_that_leans_on_an_edge_does_not_sink_in(
    make_vehicle, make_table, make_plant, com
):
    table = make_table(tilt={"uniform": (0.0, -PUSH)})
    plant = make_plant([make_vehicle(com=com)], [at(0.1, -WALL)], table)
    seen = plant.advance(5.0, LOOKS)
    assert -seen[:, 0, 1].min() - WALL < 1e-6
    assert [touch.other for touch in plant.touches] in ([], ["lower edge"])


def test_a_vehicle_that_leans_on_another_does_not_sink_in(make_vehicle, make_table, make_plant):
    table = make_table(tilt={"uniform": (PUSH, 0.0)})
    plant = make_plant(
        [make_vehicle(), make_vehicle(mass=4.0)], [at(WALL - 0.4, 0), at(WALL, 0)], table
    )
    seen = plant.advance(5.0, LOOKS)
    assert seen[:, 1, 0].max() - WALL < 1e-6
    assert (seen[:, 0, 0] - seen[:, 1, 0]).max() + 2 * RADIUS < 1e-5
    assert np.abs(plant.x[:, 3:]).max() < 2e-3


def test_jets_that_never_stop_do_not_push_through(make_vehicle, make_table, make_plant, make_plan):
    plant = make_plant([make_vehicle()], [at(-WALL + 0.05, 0)], make_table(restitution=0.1))
    for k in range(50):
        plant.boards["0"].apply(make_plan(0.1 * k, {0: (0.0, 0.1), 1: (0.0, 0.1)}))
        plant.advance(0.1 * (k + 1))
    assert plant.x[0, 0] == pytest.approx(-WALL, abs=1e-4)
    assert len(plant.touches) == 1


def test_a_vehicle_pushed_into_a_corner_stays_there(make_vehicle, make_table, make_plant):
    table = make_table(restitution=0.1, tilt={"uniform": (PUSH, 0.7 * PUSH)})
    plant = make_plant([make_vehicle()], [at(WALL - 0.1, WALL - 0.05)], table)
    seen = plant.advance(5.0, LOOKS)
    assert seen[:, 0, :2].max() - WALL < 1e-6
    assert_allclose(plant.x[0, :2], WALL, atol=1e-4)
    assert_allclose(plant.x[0, 3:], 0.0, atol=1e-3)
    assert [touch.other for touch in plant.touches] == ["upper edge", "right edge"]


@pytest.mark.parametrize("velocity", [(0.5, 0.5), (0.5, 0.501), (0.6, 0.2)])
def test_a_vehicle_thrown_into_a_corner_comes_back(make_vehicle, make_table, make_plant, velocity):
    start = at(WALL - 0.3, WALL - 0.3, *velocity)
    plant = make_plant([make_vehicle()], [start], make_table(restitution=1.0))
    plant.advance(3.0)
    assert_allclose(plant.x[0, 3:5], -np.array(velocity), atol=1e-12)
    assert {touch.other for touch in plant.touches} == {"upper edge", "right edge"}


def test_nothing_stops_a_rock_that_pushes_a_vehicle_over_the_edge(make_vehicle, make_plant):
    rock = Obstacle(position=(WALL - 1.0, 0.0), radius=1.0, solid=0.5, velocity=(0.2, 0.0))
    plant = make_plant([make_vehicle()], [at(WALL - 0.1, 0)], obstacles={"rock": rock})
    plant.advance(5.0)
    assert plant.x[0, 0] == pytest.approx(WALL - 1.0 + 0.2 * 5.0 + 0.5 + RADIUS, abs=1e-3)
    assert plant.x[0, 3] < 0.5
    assert [touch.other for touch in plant.touches] == ["rock", "right edge"]


def test_an_overlap_is_taken_out_about_the_common_centre(make_vehicle, make_plant):
    vehicles = [make_vehicle(), make_vehicle(mass=4.0)]
    plant = make_plant(vehicles, [at(-0.1, 0, 0.2), at(0.2, 0, 0.2 - 1e-6)])  # 0.1 m too near
    plant.advance(0.001)
    assert plant.x[1, 0] - plant.x[0, 0] == pytest.approx(2 * RADIUS, abs=1e-6)
    centre = (12.5 * plant.x[0, 0] + 4.0 * plant.x[1, 0]) / 16.5
    assert centre == pytest.approx((-1.25 + 0.8) / 16.5 + 0.2 * 0.001, abs=1e-6)


# Head-on and grazing


def test_equal_discs_that_meet_head_on_swap_velocities(make_vehicle, make_table, make_plant):
    plant = make_plant(
        [make_vehicle()] * 2, [at(-1, 0, 0.3), at(1, 0, -0.2)], make_table(restitution=1.0)
    )
    plant.advance(5.0)
    assert_allclose(plant.x[:, 3:], [[-0.2, 0, 0], [0.3, 0, 0]], atol=1e-14)


@pytest.mark.parametrize(("speed", "bounces"), [(0.0009, False), (0.0011, True)])
def test_what_meets_slower_than_a_millimetre_a_second_does_not_bounce(
    make_vehicle, make_table, make_plant, speed, bounces
):
    start = at(WALL - 0.0002, 0, speed)
    plant = make_plant([make_vehicle()], [start], make_table(restitution=1.0))
    plant.advance(1.0)
    assert plant.x[0, 3] == pytest.approx(-speed if bounces else 0.0, abs=1e-15)


@pytest.mark.parametrize("depth", [0.001, 0.01, 0.1])
def test_a_grazing_touch_is_seen_and_changes_little(make_vehicle, make_table, make_plant, depth):
    passing = 2 * RADIUS - depth
    plant = make_plant(
        [make_vehicle()] * 2,
        [at(-1, 0, 0.3), at(1, passing, -0.3)],
        make_table(restitution=1.0),
    )
    plant.advance(5.0)
    normal = np.array([np.sqrt((2 * RADIUS) ** 2 - passing**2), passing]) / (2 * RADIUS)
    kick = 0.6 * normal[0] * normal  # each loses what it had along the normal of the other
    assert len(plant.touches) == 1
    assert plant.touches[0].speed == pytest.approx(0.6 * normal[0], abs=1e-9)
    assert_allclose(plant.x[0, 3:5], (0.3 - kick[0], -kick[1]), atol=1e-9)
    assert_allclose(plant.x[1, 3:5], (-0.3 + kick[0], kick[1]), atol=1e-9)
    assert_allclose(plant.x[:, 5], 0.0)  # there is no friction


def test_a_knock_travels_through_a_row(make_vehicle, make_table, make_plant):
    row = [at(-1, 0, 0.5), at(0, 0), at(2 * RADIUS, 0), at(4 * RADIUS, 0)]
    plant = make_plant([make_vehicle()] * 4, row, make_table(restitution=1.0))
    plant.advance(3.0)
    assert_allclose(plant.x[:, 3], [0.0, 0.0, 0.0, 0.5], atol=1e-9)
