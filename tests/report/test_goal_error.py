"""How far everybody is from what is asked of him, against distances worked out by hand."""

import msgspec
import numpy as np
import pytest

from testbed.config import SHIPPED, load
from testbed.report.goal_error import GoalError, goal_at

T = np.array([0.0, 10.0, 20.0])


def still(*places) -> dict[str, np.ndarray]:
    return {f"sat{k}": np.tile(np.array(p, dtype=float), (3, 1)) for k, p in enumerate(places, 1)}


def shipped(name: str, *overrides: str):
    places = [SHIPPED / folder / f"{name}.toml" for folder in ("experiments", "scenarios")]
    return load(next(place for place in places if place.is_file()), overrides)


def test_a_goal_that_stands():
    hold = GoalError(shipped("hold", "duration_s=20"))
    assert hold.title == "Distance to the goal"
    off = hold.parts(T, {"sat1": np.array([[3.0, 4.0]] * 3)})
    assert off["sat1"] == pytest.approx([5.0, 5.0, 5.0])


def test_a_goal_that_moves():
    circle = shipped("circle")
    name, setup = next(iter(circle.vehicles.items()))
    where = goal_at(setup, T)
    assert np.linalg.norm(where[1] - where[0]) > 0.1
    assert GoalError(circle).parts(T, {name: where})[name] == pytest.approx(0.0, abs=1e-12)


def test_edges_of_a_formation_and_to_its_leader():
    goal_error = GoalError(shipped("xue2024_table_constant"))
    lengths = {(e.a, e.b): e.length for e in goal_error.edges}
    off = goal_error.parts(T, still((0.0, 0.0), (1.0, 0.0), (2.0, 0.0)))
    assert off["sat1, sat2"] == pytest.approx(abs(1.0 - lengths["sat1", "sat2"]))
    led = np.hypot(*(goal_error.leader_at(T) - [2.0, 0.0]).T) - lengths["sat3", "leader"]
    assert off["sat3, leader"] == pytest.approx(np.abs(led))
    assert led[0] != led[2]  # the leader moves
    by_vehicle = goal_error.by_vehicle(T, still((0.0, 0.0), (1.0, 0.0), (2.0, 0.0)))
    assert by_vehicle["sat3"] == pytest.approx(np.maximum(off["sat2, sat3"], off["sat3, leader"]))


def test_lengths_in_the_units_of_a_scaled_law():
    plain = GoalError(shipped("formation"))
    params = shipped("formation").controller
    half = type(params.scale)(length=2.0)

    scaled = msgspec.structs.replace(
        shipped("formation"), controller=msgspec.structs.replace(params, scale=half)
    )
    assert [e.length for e in GoalError(scaled).edges] == [e.length / 2.0 for e in plain.edges]


def test_curves_of_a_formation():
    goal_error = GoalError(shipped("ring"))
    assert goal_error.forms
    assert "curve" in goal_error.title
    off = goal_error.parts(T, {"sat1": np.zeros((3, 2))})["sat1"]
    assert np.all(np.isnan(off) | (off > 0.0))
