"""At a contact the distance is that of the rims, also if no frame shows it."""

from testbed.core.table import Obstacle
from testbed.metrics.run_metrics import Touch
from testbed.metrics.touching import nearest_obstacles, nearest_vehicles, smallest_gap

RADII = {"a": 0.3, "b": 0.25, "c": 0.2}
OBSTACLES = {"rock": Obstacle((0.0, 0.0), 0.7, solid=0.2), "far": Obstacle((3.0, 0.0), 0.5)}


def touch(vehicle: str, other: str) -> Touch:
    return Touch(1.0, vehicle, other, 0.1)


def test_vehicles_that_touched_were_as_near_as_their_rims():
    assert nearest_vehicles(0.5509, [touch("b", "a")], RADII) == 0.55
    assert nearest_vehicles(0.5491, [touch("b", "a")], RADII) == 0.5491


def test_without_a_contact_of_two_vehicles_the_frames_count():
    assert nearest_vehicles(0.5509, [], RADII) == 0.5509
    assert nearest_vehicles(0.5509, [touch("a", "rock"), touch("a", "east edge")], RADII) == 0.5509
    assert nearest_vehicles(None, [touch("a", "rock")], RADII) is None


def test_an_obstacle_that_was_touched_was_as_near_as_its_body():
    sampled, touches = {"rock": 0.501, "far": 2.5}, [touch("a", "rock"), touch("b", "east edge")]
    near = nearest_obstacles(sampled, touches, "a", 0.3, OBSTACLES)
    assert near == {"rock": 0.5, "far": 2.5}
    assert nearest_obstacles(sampled, touches, "b", 0.25, OBSTACLES) == sampled


def test_two_vehicles_that_touched_have_no_gap():
    assert smallest_gap(0.0009, [touch("b", "a")], list(RADII)) == 0.0
    assert smallest_gap(-0.0009, [touch("b", "a")], list(RADII)) == -0.0009
    assert smallest_gap(0.0009, [touch("a", "rock")], list(RADII)) == 0.0009
