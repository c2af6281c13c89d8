"""What a swarm's measures tell apart: full and hollow balls, the first arrival and the last."""

import numpy as np
import pytest

from controllers.bifurcating import Phase
from sim_twin.orbit.swarm import Flight
from testbed.reproduction.claim import CORRECTED, FAILS, judge
from testbed.reproduction.cluster import Swarming, measure, snapshot
from testbed.reproduction.layout import cuts, spiral
from testbed.reproduction.paper import read_papers

BALL = Phase(a=1.0, b=1.0, c=1.0, r=0.0, mu=-1.0, k_f=3.0, k_v=2000.0, k_c=0.25, s=1.0)


@pytest.fixture(scope="module")
def paper():
    return read_papers(["gao2022"])["gao2022"]


def verdict(paper, positions):
    claim = next(claim for claim in paper.claims if claim.id == "ball")
    depth = snapshot(BALL, positions, 0.0 * positions)["depth"]
    return judge("gao2022", paper, claim, {"ball": {"depth at 2000": [depth]}}, quick=True).outcome


def test_a_hollow_shell_is_no_ball_that_is_filled_evenly(paper):
    assert verdict(paper, 500.0 * spiral(50)) == FAILS


def test_two_shells_in_each_other_are_none_either(paper):
    assert verdict(paper, 500.0 * np.concatenate([spiral(25), 0.2 * spiral(25)])) == FAILS


def test_an_even_ball_is_one(paper):
    evens = list(cuts(50, np.ones(3)))[::100]
    assert len(evens) > 5
    assert {verdict(paper, 250.0 * x) for x in evens} == {CORRECTED}


def test_a_swarm_that_overshoots_arrives_before_it_stays():
    line = Phase(a=1.0, b=0.0, r=1.0, s=0.2, mu=-1.0, k_c=0.25, k_v=2000.0, k_f=10.0, sigma=5.0)
    run = Swarming((line,), 1, duration_s=60.0, times=(60,), formed_m=25.0)
    z = np.array([100.0, 20.0, 80.0, 20.0, 10.0, 5.0, 5.0])  # distance from z = 0
    p = np.zeros((7, 2, 3))
    p[:, 1, 0], p[:, :, 2] = 50.0, z[:, None]
    flight = Flight(p, 0.0 * p, p, 0.0 * p, 0.0 * p, np.zeros((7, 6)), 0, 0)
    found = measure(run, flight)
    assert (found["arrived_s"], found["formed_s"]) == (10.0, 30.0)
