"""A path that its vehicle cannot follow is refused, with the key and the reason."""

import pytest

from testbed.config import SHIPPED, ConfigError, load

PATH = SHIPPED / "scenarios" / "uky_path.toml"
KEY = "vehicles.sat1.path"


def refused(path, *more):
    with pytest.raises(ConfigError) as caught:
        load(PATH, [f"{KEY}={path}", *more])
    return caught.value


@pytest.mark.parametrize(
    ("path", "key", "expected", "found"),
    [
        ('{type="points", points=[], speed=0.05}', f"{KEY}.points", "a list of 1 to 1000",
         "0 entries"),
        ('{type="points", points=[[0,0],[-1,0]], speed=0.05}', f"{KEY}.points.1",
         "1 mm from the goal, (0, 0)", "[0.0, 0.0]"),
        ('{type="points", points=[[-1,0],[-1,0],[-1,-1]], speed=0.05}', f"{KEY}.points.2",
         "1 mm from point 1", "[-1.0, 0.0]"),
        ('{type="points", points=[[-1,0]], speed=0.15, ramp_s=1.0}', KEY,
         "that the jets can follow", "m/s^2"),
        ('{type="circle", radius=0.1, period_s=8}', KEY, "that the jets can follow", "m/s^2"),
        ('{type="circle", radius=0.1, period_s=80, heading="ahead"}', f"{KEY}.heading",
         "one of: along, goal", '"ahead"'),
        ('{type="points", points=[[-9,0]], speed=0.07}', KEY, "a path on the table", "after"),
    ],
)  # fmt: skip
def test_a_bad_path_is_refused(path, key, expected, found):
    error = refused(path)
    assert error.key == key
    assert expected in str(error.expected)
    assert found in str(error.found)


def test_a_turn_that_the_jets_cannot_make_is_refused():
    hairpin = '{type="points", points=[[-0.5,0],[-0.51,0.01],[-0.5,0.02]], speed=0.02, ramp_s=5'
    load(PATH, [f"{KEY}={hairpin}}}"])
    error = refused(hairpin + ', heading="along"}')
    assert "along which the jets can turn" in error.expected


def test_a_path_faster_than_the_safety_filter_lets_the_vehicle_fly_is_refused():
    path, slow = '{type="points", points=[[-3,0]], speed=0.1}', "flight.barrier.max_speed=0.08"
    load(PATH, [f"{KEY}={path}"])
    assert "no faster than flight.barrier.max_speed, 0.08 m/s" in refused(path, slow).expected
    load(PATH, [f"{KEY}={path}", slow, "flight.barrier.on=false"])
