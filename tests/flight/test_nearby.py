"""A push near a body or an edge is said to be a possible contact."""

import pytest

from testbed.core.table import Obstacle
from testbed.core.types import Accel, Pose, State, Twist
from testbed.flight.nearby import NEAR, RECENT, Nearby

RADIUS, SIZE = 0.2, (6.0, 4.0)


def state(x, y, t=0.0):
    return State(t, Pose(x, y, 0.0), Twist(0.0, 0.0, 0.0), Accel(0.0, 0.0, 0.0), 0.0, 0)


def nearby(**obstacles):
    return Nearby(RADIUS, SIZE, obstacles, {"sat2": 0.5})


ROCK = Obstacle((1.0, 0.0), 0.8, solid=0.3)


@pytest.mark.parametrize(
    ("x", "y", "others", "text"),
    [
        (0.48, 0.0, {}, "contact with rock (2.0 cm away)"),
        (0.51, 0.0, {}, "contact with rock (0.0 cm away)"),  # an estimate may be inside
        (0.44, 0.0, {}, ""),
        (-2.79, 0.0, {}, "contact with the left edge (1.0 cm away)"),
        (0.0, 1.77, {}, "contact with the upper edge (3.0 cm away)"),
        (-1.0, 0.0, {"sat2": state(-1.51, 0.0)}, "contact with sat2 (1.0 cm away)"),
        (-1.0, 0.0, {"sat2": state(-1.7, 0.0)}, ""),
    ],
)
def test_what_is_near_is_named(x, y, others, text):
    around = nearby(rock=ROCK)
    around.look(0.0, state(x, y), others)
    assert around.contact(0.0) == text


def test_an_obstacle_without_a_body_is_not_touched():
    around = nearby(zone=Obstacle((1.0, 0.0), 0.8))
    around.look(0.0, state(1.0, 0.0), {})
    assert around.contact(0.0) == ""


def test_a_moving_obstacle_is_where_it_is_now():
    around = nearby(rock=Obstacle((1.0, 0.0), 0.8, solid=0.3, velocity=(0.0, 0.1)))
    around.look(10.0, state(0.48, 1.0, t=10.0), {})
    assert around.contact(10.0) == "contact with rock (2.0 cm away)"


def test_the_smallest_gap_is_remembered_for_a_while():
    around = nearby(rock=ROCK)
    for t, x in ((0.0, 0.47), (0.1, 0.49), (0.2, 0.46), (0.3, 0.3)):
        around.look(t, state(x, 0.0, t=t), {})
    assert around.contact(0.3) == "contact with rock (1.0 cm away)"
    assert around.contact(0.2 + RECENT) == ""
    around.look(9.0, state(0.5 - 0.9 * NEAR, 0.0, t=9.0), {})
    assert around.contact(9.0) == "contact with rock (4.5 cm away)"
