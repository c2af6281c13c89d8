"""Guidance: what it asks its law, what it sends, and when it is for."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace
from scipy.optimize import linprog

from controllers.pd import PdParams, pd
from testbed.core.jets import effect_matrix
from testbed.core.law import Ahead
from testbed.core.path import Circle
from testbed.core.se2 import to_table
from testbed.core.table import Obstacle
from testbed.core.types import Demand, Pose, Trajectory
from testbed.core.vehicle import Jet
from testbed.flight.guidance import Guidance, GuidanceParams, weakest_force
from testbed.flight.turn import Turn, turn_to

PERIOD = 0.1  # [s]
GOAL = Pose(0.5, -0.4, 2.0)
ROCKS = [
    Obstacle((1.0, 0.5), 0.8),
    Obstacle((-1.0, 0.0), 0.6, velocity=(0.05, -0.02)),
]


class Probe:
    """A law that pushes as it is told and writes down what it was asked."""

    message_size = 0

    def __init__(self, forces=None):
        self.forces = iter(forces or [])
        self.asked = []

    def initial(self, own, neighbours, world):
        return np.zeros(1)

    def propagate(self, law_state, own, neighbours, world, t, duration, steps):
        self.asked.append((law_state.copy(), own, neighbours, world, t, duration, steps))
        force = next(self.forces, np.zeros(2))
        a = force / own.mass + own.disturbance
        p, v = own.p + duration * (own.v + 0.5 * duration * a), own.v + duration * a
        return Ahead(law_state + 1.0, p, v, force, np.zeros(0))


@pytest.fixture
def make_guidance(vehicle):
    def make(law, mode="reference", period=PERIOD, **params):
        return Guidance(GuidanceParams(mode=mode, **params), law, vehicle, GOAL, ROCKS, period)

    return make


# Force limit


def test_weakest_force_of_the_shipped_vehicle(vehicle):
    assert weakest_force(vehicle) == pytest.approx(1.2)  # two jets of 0.6 N each way


def strongest(vehicle, angle):
    """The largest force without a torque in one direction of B."""
    effect = effect_matrix(vehicle.jets, about=vehicle.com)
    columns = np.column_stack([effect, [-math.cos(angle), -math.sin(angle), 0.0]])
    n = effect.shape[1]
    bounds = [(0.0, 1.0)] * n + [(0.0, None)]
    return -linprog(-np.eye(n + 1)[n], A_eq=columns, b_eq=np.zeros(3), bounds=bounds).fun


def weakest_by_trying(vehicle):
    return min(strongest(vehicle, angle) for angle in np.linspace(0.0, 2.0 * math.pi, 73))


def test_the_shipped_vehicle_has_it_in_every_direction(vehicle):
    assert weakest_by_trying(vehicle) == pytest.approx(weakest_force(vehicle), rel=1e-6)


def turned(jet, angle):
    """The jet on a body whose axes are drawn `angle` further back."""
    return replace(jet, position=to_table(angle, *jet.position), push=to_table(angle, *jet.push))


def test_weakest_force_does_not_depend_on_how_the_axes_are_drawn(vehicle):
    diagonal = replace(vehicle, jets=[turned(jet, math.pi / 4.0) for jet in vehicle.jets])
    assert weakest_by_trying(diagonal) == pytest.approx(1.2)
    assert weakest_force(diagonal) == pytest.approx(1.2)


def test_weakest_force_does_not_turn_the_vehicle(vehicle):
    # three mounts, each with a jet either way round
    jets = [
        turned(Jet((0.15, 0.0), (0.0, way), 0.6), mount * math.pi / 1.5)
        for mount in range(3)
        for way in (1.0, -1.0)
    ]
    triangle = replace(vehicle, jets=jets)
    assert weakest_force(triangle) == pytest.approx(weakest_by_trying(triangle), rel=0.01)


@pytest.mark.parametrize("share", [0.3, 1.0])
def test_a_law_is_given_its_share_of_the_force(share, vehicle, make_guidance, make_state):
    probe = Probe()
    make_guidance(probe, force_share=share).step(0.0, make_state(), {})
    assert probe.asked[0][1].max_force == pytest.approx(share * 1.2)
    assert probe.asked[0][1].mass == vehicle.mass


# Turn


headings = st.floats(-3.1, 3.1)
accels = st.floats(1e-3, 1.0)


@given(start=headings, end=headings, accel=accels, begin=st.floats(0.0, 100.0))
def test_a_turn_ends_at_its_heading(start, end, accel, begin):
    turn = Turn(start, end, begin, accel)
    assert turn.at(begin - 1.0) == pytest.approx((start, 0.0, 0.0))
    assert turn.at(begin) == pytest.approx((start, 0.0, 0.0))
    theta, omega, alpha = turn.at(begin + 1e4)
    assert math.remainder(theta - end, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)
    assert (omega, alpha) == pytest.approx((0.0, 0.0), abs=1e-9)


@given(start=headings, end=headings, accel=accels)
def test_a_turn_never_accelerates_harder(start, end, accel):
    turn = Turn(start, end, 0.0, accel)
    span = math.sqrt(10.0 / math.sqrt(3.0) * math.pi / accel)
    peak = max(abs(turn.at(t)[2]) for t in np.linspace(0.0, span, 1500).tolist())
    assert peak <= accel * (1.0 + 1e-9)


def test_a_turn_accelerates_as_hard_as_it_may():
    turn, span = Turn(0.0, 2.0, 0.0, 0.02), math.sqrt(20.0 / math.sqrt(3.0) / 0.02)
    peak = max(turn.at(t)[2] for t in np.linspace(0.0, span, 10_000).tolist())
    assert peak == pytest.approx(0.02, rel=1e-6)
    assert turn.at(span)[0] == pytest.approx(2.0)
    assert turn.at(0.99 * span)[0] < 2.0


@pytest.mark.parametrize(
    ("start", "end", "way"),
    [(3.0, -3.0, 2.0 * math.pi - 6.0), (-3.0, 3.0, 6.0 - 2.0 * math.pi), (0.0, 3.0, 3.0)],
)
def test_a_turn_goes_the_shorter_way(start, end, way):
    assert Turn(start, end, 0.0, 0.02).at(1e4)[0] == pytest.approx(start + way)


def test_rates_of_a_turn_are_its_derivatives():
    turn, h = Turn(0.3, -2.5, 1.0, 0.05), 1e-4
    for t in np.linspace(1.5, 10.0, 40).tolist():
        back, here, ahead = (turn.at(t + k * h) for k in (-1, 0, 1))
        assert here[1] == pytest.approx((ahead[0] - back[0]) / (2.0 * h), abs=1e-6)
        assert here[2] == pytest.approx((ahead[1] - back[1]) / (2.0 * h), abs=1e-6)


def test_no_turn_stays():
    assert Turn(0.7, 0.7, 0.0, 0.02).at(3.0) == (0.7, 0.0, 0.0)


# Reference mode


def test_references_are_contiguous(make_guidance, make_state):
    guidance = make_guidance(pd(PdParams(bandwidth=0.5)))
    sent = [guidance.step(0.2 + PERIOD * k, make_state((1.0, 0.3, 0.1)), {}) for k in range(100)]
    assert all(isinstance(trajectory, Trajectory) for trajectory in sent)
    for k, trajectory in enumerate(sent):
        times = [reference.t for reference in trajectory.references]
        assert times == pytest.approx(0.2 + PERIOD * (k + np.arange(len(times))), abs=1e-9)
    for one, two in pairwise(sent):
        assert one.references[1:] == two.references[: len(one.references) - 1]


@pytest.mark.parametrize(("preview", "count"), [(0.0, 1), (0.04, 1), (0.1, 2), (0.3, 4), (0.5, 6)])
def test_references_cover_the_preview(preview, count, make_guidance, make_state):
    guidance = make_guidance(pd(PdParams()), preview_s=preview, setpoint_life_s=0.7)
    for k in range(3):
        trajectory = guidance.step(PERIOD * k, make_state(), {})
        assert len(trajectory.references) == count
        assert trajectory.valid_until == pytest.approx(trajectory.references[-1].t + 0.7)


def test_references_obey_the_double_integrator(make_guidance, make_state):
    guidance = make_guidance(pd(PdParams(bandwidth=0.5)))
    line = [guidance.step(PERIOD * k, make_state((1.0, 0.3, 0.1)), {}) for k in range(80)]
    line = [trajectory.references[0] for trajectory in line]
    for one, two in pairwise(line):
        assert two.twist.vx - one.twist.vx == pytest.approx(PERIOD * one.accel.ax, abs=1e-12)
        assert two.twist.vy - one.twist.vy == pytest.approx(PERIOD * one.accel.ay, abs=1e-12)
        mean = 0.5 * (one.twist.vx + two.twist.vx)
        assert two.pose.x - one.pose.x == pytest.approx(PERIOD * mean, abs=1e-5)


def test_the_reference_model_starts_at_rest_where_the_vehicle_is(make_guidance, make_state):
    state = make_state((1.0, 0.3, 0.1), (0.2, 0.2, 0.2), (0.1, 0.1, 0.1))
    first = make_guidance(pd(PdParams())).step(0.7, state, {}).references[0]
    assert first.t == 0.7
    assert first.pose == Pose(1.0, 0.3, 0.1)
    assert (first.twist.vx, first.twist.vy, first.twist.omega) == (0.0, 0.0, 0.0)


def test_nothing_disturbs_the_reference_model(make_guidance, make_state):
    one, other = (make_guidance(pd(PdParams())) for _ in range(2))
    for k in range(50):
        here = make_state((0.1, 0.2, 0.3))
        there = here if k == 0 else make_state((9.0, 9.0, 1.0), (1.0, 1.0, 1.0), (1.0, 1.0, 1.0))
        assert one.step(PERIOD * k, here, {}) == other.step(PERIOD * k, there, {})


def test_the_reference_arrives_at_the_goal(make_guidance, make_state):
    guidance = make_guidance(pd(PdParams(bandwidth=0.3)))
    for k in range(900):
        last = guidance.step(PERIOD * k, make_state(), {}).references[0]
    assert (last.pose.x, last.pose.y, last.pose.theta) == pytest.approx((0.5, -0.4, 2.0), abs=1e-6)


# What the law is asked


def test_the_law_is_flown_at_a_fine_step(make_guidance, make_state):
    probe = Probe()
    make_guidance(probe, period=0.05, step_s=0.0003).step(0.0, make_state(), {})
    *_, duration, steps = probe.asked[0]
    assert duration == 0.05
    assert steps == 167  # the smallest number that keeps a step within 0.3 ms


def test_the_law_state_is_carried_on(make_guidance, make_state):
    probe = Probe()
    guidance = make_guidance(probe, mode="wrench")
    for k in range(5):
        guidance.step(PERIOD * k, make_state(t=PERIOD * k), {})
    assert [asked[0][0] for asked in probe.asked] == [0.0, 1.0, 2.0, 3.0, 4.0]


@pytest.mark.parametrize("mode", ["reference", "wrench"])
def test_the_world_is_shown_as_it_will_be(mode, make_guidance, make_state):
    probe = Probe()
    guidance = make_guidance(probe, mode=mode, neighbour_distance=0.7)
    heard = {
        "b": make_state((1.0, 2.0, 0.0), (0.1, -0.2, 0.0), t=2.5),
        "a": make_state((-1.0, 0.0, 0.0), (0.0, 0.3, 0.0), t=2.9),
    }
    guidance.step(3.0, make_state(t=3.0), heard)
    _, _, others, world, t, _, _ = probe.asked[0]
    assert t == 3.0
    assert others.p == pytest.approx(np.array([[-1.0, 0.03], [1.05, 1.9]]))
    assert others.v == pytest.approx(np.array([[0.0, 0.3], [0.1, -0.2]]))
    assert others.radius.tolist() == [0.7, 0.7]
    assert world.obstacles.p == pytest.approx(np.array([[1.0, 0.5], [-0.85, -0.06]]))
    assert world.obstacles.v.tolist() == [[0.0, 0.0], [0.05, -0.02]]
    assert world.obstacles.radius.tolist() == [0.8, 0.6]
    assert world.goal.p.tolist() == [0.5, -0.4]
    assert not np.any([world.goal.v, world.goal.a, world.goal.jerk])


# Wrench mode


def test_a_demand_is_the_mean_force_and_the_turn(make_guidance, make_state):
    guidance = make_guidance(Probe([np.array([0.3, -0.1])]), mode="wrench", setpoint_life_s=0.4)
    demand = guidance.step(2.0, make_state((0.0, 0.0, 0.5), t=2.0), {})
    assert demand == Demand(2.0, 0.3, -0.1, 0.5, 0.0, 0.0, 2.4)
    later = guidance.step(5.0, make_state(t=5.0), {})
    assert (later.theta, later.omega, later.alpha) == Turn(0.5, 2.0, 2.0, 0.02).at(5.0)


@pytest.mark.parametrize("lag", [0.0, 0.04, 0.1, 0.135, 0.27, 0.5])
def test_oracle_prediction_through_demands_in_flight(lag, vehicle, make_guidance, make_state):
    # the estimate is `lag` older than the period it is for, with what was sent in between
    rng = np.random.default_rng(0)
    forces = list(rng.normal(size=(12, 2)))
    probe, start, disturbance = Probe(forces), 1.0, np.array([0.01, -0.02])
    guidance = make_guidance(probe, mode="wrench")
    for k in range(12):
        t = start + PERIOD * k
        own = make_state((0.2, 0.1, 0.0), (0.05, -0.03, 0.2), (*disturbance, 0.3), t=t - lag)
        guidance.step(t, own, {})
        p, v = np.array([0.2, 0.1]), np.array([0.05, -0.03])
        grid = np.linspace(t - lag, t, 2001)
        h = lag / 2000
        for now in grid[:-1] + 0.5 * h:
            n = math.floor((now - start) / PERIOD)
            a = disturbance + (forces[n] / vehicle.mass if n >= 0 else 0.0)
            p, v = p + h * (v + 0.5 * h * a), v + h * a
        asked = probe.asked[-1][1]
        assert asked.p == pytest.approx(p, abs=1e-5)
        assert asked.v == pytest.approx(v, abs=1e-4)
        assert asked.disturbance == pytest.approx(disturbance)


def test_prediction_is_exact_from_one_period_to_the_next(vehicle, make_guidance, make_state):
    force = np.array([0.6, 0.3])
    probe = Probe([force])
    guidance = make_guidance(probe, mode="wrench")
    guidance.step(0.0, make_state(t=0.0), {})
    guidance.step(PERIOD, make_state(t=0.0), {})
    a = force / vehicle.mass
    assert probe.asked[1][1].p == pytest.approx(0.5 * PERIOD**2 * a, rel=1e-12)
    assert probe.asked[1][1].v == pytest.approx(PERIOD * a, rel=1e-12)


def test_wrench_mode_closes_the_loop_on_the_estimate(make_guidance, make_state):
    guidance = make_guidance(pd(PdParams(bandwidth=0.3)), mode="wrench")
    near = guidance.step(0.0, make_state((0.4, -0.4, 0.0)), {})
    far = guidance.step(0.1, make_state((0.0, -0.4, 0.0), t=0.1), {})
    assert 0.0 < near.fx_w < far.fx_w
    assert far.fx_w <= 0.6 * 1.2 + 1e-12


def test_a_heading_along_a_path_begins_where_the_vehicle_points_and_joins_the_path():
    path = Circle(radius=0.8, period_s=90.0, start_deg=20.0, heading="along")
    turn, rate = turn_to(0.3, path, -1.0, 5.0, 0.02), 2.0 * math.pi / 90.0
    theta, omega, alpha = turn.at(5.0)
    assert math.cos(theta + 1.0) == pytest.approx(1.0)
    assert (omega, alpha) == (pytest.approx(rate), 0.0)
    assert math.cos(turn.at(60.0)[0] - path.tangent(60.0)[0]) == pytest.approx(1.0)
    assert turn.at(60.0)[1:] == pytest.approx((rate, 0.0))
    assert turn_to(0.3, None, -1.0, 5.0, 0.02).at(1e3)[0] == pytest.approx(0.3)
