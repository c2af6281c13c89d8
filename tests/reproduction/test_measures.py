"""Measures of single flights, on flights that are written down here."""

import numpy as np
import pytest

from testbed.reproduction.fleet_simulation import Tracks, obstacles
from testbed.reproduction.kernel.fleet import FleetFlight
from testbed.reproduction.paper import read_papers
from testbed.reproduction.scene import Obstacles, WaveParams, place
from testbed.reproduction.targets import measure_one

ROUND = WaveParams(cosine=(2.0, 0.0, 0.0), sine=(0.0, 2.0, 0.0), w=0.01)  # back after 628 s


def standing(p, seconds):
    t = np.arange(0.0, seconds)
    here = np.tile(np.array([p, [0.0, 0.0, 0.0]]), (len(t), 1, 1))  # the leader is the last
    return Tracks(t, here, 0.0 * here, np.zeros((len(t), 2, 2)))


def test_an_obstacle_that_circles_is_felt_each_time_it_comes_back():
    where = place(None, obstacles=Obstacles(((60.0, 0.0, 0.0),), 10.0, ROUND))
    found = obstacles(where, standing([100.0, 0.0, 0.0], 700), band=30.0)
    assert found["obstacle_felt_s"][0] == pytest.approx(628.0 + 40.0, abs=30.0)
    assert found["obstacle_m"][0] < 40.0
    once = obstacles(where, standing([100.0, 0.0, 0.0], 400), band=30.0)
    assert once["obstacle_felt_s"][0] < 100.0


def test_an_obstacle_that_is_never_near_is_never_felt():
    where = place(None, obstacles=Obstacles(((60.0, 0.0, 0.0),), 10.0))
    assert obstacles(where, standing([200.0, 0.0, 0.0], 9), 30.0)["obstacle_felt_s"] == [0.0]
    assert obstacles(place(None), standing([200.0, 0.0, 0.0], 9), 30.0) == {}


def test_control_far_from_obstacles_that_is_zero_gives_no_ratio():
    run = read_papers(["zhang2023"])["zhang2023"].runs["pd"]
    satellite, t = run.satellites["sat1"], np.arange(0.0, 200.0)
    p = np.tile(np.array(satellite.obstacles[0]) + 10.0, (200, 1, 1))
    idle = FleetFlight(t, p, 0.0 * p, p[:, :, :0], 0.0 * p, p[0], p[0])
    assert measure_one(run, satellite, idle)["near_to_far"] is None
