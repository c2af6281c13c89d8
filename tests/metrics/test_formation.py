"""Formations against closed forms: edges, curves, five elements, what the certificate says."""

import msgspec
import numpy as np
import pytest

from controllers.bifurcating import BifurcatingParams, Phase
from controllers.bifurcating_design import Fleet
from controllers.bounded_formation import BoundedFormationParams
from controllers.bounded_leader import BoundedLeaderParams
from controllers.graph import FormationParams
from controllers.pd import PdParams
from controllers.proxy import ProxyParams
from controllers.scale import Scale
from testbed.metrics.formation import FormationContext, formation_metrics, has_formation
from testbed.metrics.run_metrics import (
    Criteria,
    FormationCriteria,
    Touch,
    Track,
    judge_formation,
    smallest_separation,
)

T = np.linspace(0.0, 100.0, 10_001)


def leader(t):
    return np.array([2.0, 0.01 * t])


def context(n):
    names = ["a", "b", "c", "d", "e"][:n]
    return FormationContext(names, np.full(n, 0.2), leader)


def track(*places) -> Track:
    """Vehicles at (x(t), y(t)), velocities by differences."""
    p = np.stack([np.broadcast_to(np.array(place).T, (len(T), 2)) for place in places], axis=1)
    states = np.zeros((len(T), len(places), 6))
    states[:, :, :2], states[:, :, 3:5] = p, np.gradient(p, T, axis=0)
    return Track(T, states)


def moving(x, y):
    return np.stack([x + 0.0 * T, y + 0.0 * T])


SHAPE = FormationParams(
    range=2.0, safe=0.5, far_margin=0.2, near_margin=0.2,
    distances={"a-b": 1.5, "b-c": 1.5, "a-c": 2.5},
)  # fmt: skip
PROXY = ProxyParams(spring=12.0, limit=0.8, weight=0.284, height=0.2)
CHAIN = BoundedFormationParams(SHAPE, PROXY, beta=2.4)


def judged(controller, flown, n=3):
    return formation_metrics(controller, context(n), flown)


def test_one_vehicle_is_no_formation():
    assert judged(PdParams(), track((0.0, 0.0)), n=1) is None


@pytest.mark.parametrize("n", [2, 3])
def test_five_elements_of_any_group(n):
    places = [(0.0, 0.0), (1.0, 0.0), (0.0, 2.0)][:n]
    found = judged(PdParams(), track(*places), n=n)
    assert found.end.count == n
    assert found.end.p == pytest.approx(np.mean(places, axis=0))
    assert found.closest_m == pytest.approx(0.6)  # surfaces
    assert found.widest_m == pytest.approx(found.end.outer)
    assert (found.error_m, found.settled_s, found.longest_edge_m) == (None, None, None)


def test_a_short_approach_counts_and_a_contact_between_two_frames():
    near = moving(1.0 - 0.5 * np.exp(-(((T - 37.123) / 0.02) ** 2)), 0.0)  # for 20 ms
    flown = track((0.0, 0.0), near)
    found = judged(PdParams(), flown, n=2)
    assert found.closest_m == pytest.approx(smallest_separation(flown) - 2 * 0.2)
    assert found.closest_m < 0.12
    touches = [Touch(50.0, "b", "a", 0.1)]
    met = formation_metrics(PdParams(), context(2), flown, touches)
    assert met.closest_m == 0.0
    other = formation_metrics(PdParams(), context(2), flown, [Touch(50.0, "b", "rock", 0.1)])
    assert other.closest_m == found.closest_m


def test_edges_settle_when_the_closed_form_says():
    # a comes from 1.9 m to 1.5 m with a time constant of 10 s
    gap = 1.5 + 0.4 * np.exp(-T / 10.0)
    found = judged(CHAIN, track(moving(-gap, 0.0), (0.0, 0.0), (1.5, 0.0)))
    assert found.settled_s == pytest.approx(10.0 * np.log(0.4 / 0.08), abs=0.11)
    assert found.longest_edge_m == pytest.approx(1.9)
    assert found.error_m == pytest.approx(0.4 * np.exp(-9.5), rel=0.02)
    assert found.lost_edges == 0


def test_an_edge_beyond_the_range_is_lost_and_never_settles():
    found = judged(CHAIN, track(moving(-1.5 - 0.01 * T, 0.0), (0.0, 0.0), (1.5, 0.0)))
    assert found.settled_s is None
    assert found.lost_edges == 1
    assert found.longest_edge_m == pytest.approx(2.5)
    assert found.error_m == pytest.approx(1.0)


def test_edges_of_a_scaled_law_are_measured_in_metres():
    # a law for space in the table's metres: ten of its units are one
    big = FormationParams(
        range=20.0, safe=5.0, far_margin=2.0, near_margin=2.0,
        distances={"a-b": 15.0, "b-c": 15.0, "a-c": 25.0},
    )  # fmt: skip
    law = BoundedFormationParams(big, PROXY, beta=2.4, scale=Scale(length=10.0))
    flown = track((0.0, 0.0), (1.5, 0.0), (3.0, 0.3))
    small, found = judged(CHAIN, flown), judged(law, flown)
    assert found.error_m == pytest.approx(small.error_m)
    assert found.lost_edges == small.lost_edges == 0


def test_an_edge_to_the_leader_counts_and_follows_it():
    shape = msgspec.structs.replace(SHAPE, distances=SHAPE.distances | {"c-leader": 0.9})
    law = BoundedLeaderParams(shape, PROXY, alpha=2.5, beta=1.0)
    places = [(-1.9, 0.0), (-0.4, 0.0), (1.1, 0.0)]
    still = judged(law, track(*places))
    along = judged(law, track(*(moving(x, 0.01 * T) for x, _ in places)))
    assert along.error_m == pytest.approx(0.0, abs=1e-9)
    assert along.settled_s == 0.0
    assert still.error_m == pytest.approx(np.hypot(0.9, 1.0) - 0.9, rel=0.01)


def test_the_slowest_phase_counts():
    fleet = Fleet(3, 15.0, 1.0)
    phases = (Phase(at=0.0, shape="line"), Phase(at=50.0, shape="double_line"))
    law = BifurcatingParams(phases=phases, fleet=fleet, centre=(0.0, 0.0))
    y = np.where(T < 50.0, 0.5 * np.exp(-T / 5.0), 0.75 - 0.75 * np.exp(-(T - 50.0) / 10.0))
    found = judged(law, track(moving(-1.0, y), moving(0.0, -y), moving(1.0, y)))
    assert found.settled_s == pytest.approx(10.0 * np.log(7.5), abs=0.15)
    assert found.error_m == pytest.approx(0.75 * np.exp(-4.5), rel=0.02)
    assert found.longest_edge_m is None


@pytest.mark.parametrize(("controller", "is_one"), [(CHAIN, True), (PdParams(), False)])
def test_which_laws_are_for_formations(controller, is_one):
    assert has_formation(controller) is is_one


def test_criteria_of_a_formation():
    found = judged(CHAIN, track((-1.5, 0.0), (0.0, 0.0), (1.5, 0.0)))
    wanted = FormationCriteria(error_m=0.05, settled_s=10.0, longest_edge_m=1.4)
    assert judge_formation(wanted, found) == {
        "formation.error_m": True,
        "formation.settled_s": True,
        "formation.longest_edge_m": False,
    }
    assert judge_formation(wanted, None) == dict.fromkeys(judge_formation(wanted, None), False)
    assert judge_formation(FormationCriteria(), found) == {}
    assert Criteria().formation is None
