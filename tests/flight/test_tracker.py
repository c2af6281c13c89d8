"""Tracker and what it is fed, against the motion of a free rigid body."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from stages import Tracker, brake, carry_forward, due
from testbed.core.se2 import to_table
from testbed.core.types import Accel, Demand, Pose, Reference, Trajectory, Twist
from testbed.flight.tracker import TrackerParams

PARAMS = TrackerParams()
PERIOD = 0.1  # [s]


def reference(pose=(0.0, 0.0, 0.0), twist=(0.0, 0.0, 0.0), accel=(0.0, 0.0, 0.0), t=0.0):
    return Reference(t, Pose(*pose), Twist(*twist), Accel(*accel))


def fly(vehicle, command, make_state, x, bias, ticks, period=PERIOD):
    """A free body under `command(t, state) -> Wrench`: x (ticks + 1, 6).

    The force keeps its direction in W over a period, and the estimate is the truth.
    """
    path = [np.array(x, dtype=float)]
    for k in range(ticks):
        p, v = path[-1][:3], path[-1][3:]
        state = make_state(p.tolist(), v.tolist(), bias, t=k * period)
        wrench = command(k * period, state)
        fx, fy = to_table(state.pose.theta, wrench.fx, wrench.fy)
        a = np.array([fx / vehicle.mass, fy / vehicle.mass, wrench.tau / vehicle.inertia]) + bias
        rx, ry = to_table(state.pose.theta, *vehicle.com)
        a[:2] += a[2] * ry + v[2] ** 2 * rx, v[2] ** 2 * ry - a[2] * rx  # of the origin
        path.append(np.concatenate([p + period * (v + 0.5 * period * a), v + period * a]))
    return np.array(path)


@pytest.fixture(scope="session")
def tracker(vehicle):
    return Tracker(PARAMS, vehicle)


@pytest.mark.parametrize("com", [(0.0, 0.0), (0.1, -0.2)])
@pytest.mark.parametrize("theta", [0.0, 0.7, 3.0])
def test_no_steady_error_under_a_bias(theta, com, vehicle, make_state):
    vehicle = replace(vehicle, com=com)
    tracker = Tracker(PARAMS, vehicle)
    goal = reference((0.3, -0.2, theta))
    path = fly(
        vehicle, lambda t, state: tracker.track(state, goal), make_state,
        [0.0, 0.0, theta + 0.5, 0.02, -0.01, 0.1], (0.01, -0.02, 0.05), 600,
    )  # fmt: skip
    assert path[-1] == pytest.approx([0.3, -0.2, theta, 0.0, 0.0, 0.0], abs=1e-9)


def test_error_dies_out_as_a_damped_oscillator(vehicle, make_state):
    # critically damped, in small steps: e = e0 (1 + w t) exp(-w t)
    tracker = Tracker(TrackerParams(bandwidth=0.8, heading_bandwidth=1.5), vehicle)
    goal, step = reference(), 1e-3
    path = fly(
        vehicle, lambda t, state: tracker.track(state, goal), make_state,
        [0.1, -0.2, 0.3, 0.0, 0.0, 0.0], (0.0, 0.0, 0.0), 3000, step,
    )  # fmt: skip
    w = np.array([0.8, 0.8, 1.5]) * 3.0
    expected = np.array([0.1, -0.2, 0.3]) * (1.0 + w) * np.exp(-w)
    assert path[-1][:3] == pytest.approx(expected, rel=5e-3)


def test_on_the_reference_only_its_acceleration_is_asked_for(vehicle, tracker, make_state):
    on_it = reference((1.0, 2.0, 0.5), (0.1, -0.2, 0.3), (0.02, 0.03, -0.1))
    state = make_state((1.0, 2.0, 0.5), (0.1, -0.2, 0.3))
    wrench = tracker.track(state, on_it)
    fx, fy = to_table(0.5, wrench.fx, wrench.fy)
    assert (fx, fy) == pytest.approx((vehicle.mass * 0.02, vehicle.mass * 0.03))
    assert wrench.tau == pytest.approx(vehicle.inertia * -0.1)


def test_an_origin_off_the_centre_is_moved_like_the_centre(vehicle, make_state):
    # the lever's acceleration of a spinning body that is sped up, added by hand
    heavy = replace(vehicle, com=(0.1, 0.05))
    asked = reference((1.0, 2.0, 0.0), (0.1, -0.2, 0.3), (0.02, 0.03, -0.1))
    wrench = Tracker(PARAMS, heavy).track(make_state((1.0, 2.0, 0.0), (0.1, -0.2, 0.3)), asked)
    centre = np.array([wrench.fx, wrench.fy]) / heavy.mass
    origin = centre - (-0.1) * np.array([-0.05, 0.1]) + 0.3**2 * np.array([0.1, 0.05])
    assert origin == pytest.approx([0.02, 0.03])
    assert wrench.tau == pytest.approx(heavy.inertia * -0.1)


def test_an_accelerating_reference_is_followed_without_lag(vehicle, tracker, make_state):
    start = reference((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.01, -0.02, 0.03))
    path = fly(
        vehicle, lambda t, state: tracker.track(state, carry_forward(start, t)), make_state,
        np.zeros(6), (0.003, 0.001, -0.002), 100,
    )  # fmt: skip
    end = carry_forward(start, 10.0)
    assert path[-1][:3] == pytest.approx([end.pose.x, end.pose.y, end.pose.theta], abs=1e-10)


@pytest.mark.parametrize(("theta", "wanted"), [(3.0, -3.0), (-3.0, 3.0), (0.0, 3.1)])
def test_heading_turns_the_shorter_way(theta, wanted, tracker, make_state):
    wrench = tracker.track(make_state((0.0, 0.0, theta)), reference((0.0, 0.0, wanted)))
    assert math.copysign(1.0, wrench.tau) == math.copysign(1.0, math.sin(wanted - theta))


@given(theta=st.floats(-3.0, 3.0), omega=st.floats(-0.5, 0.5))
def test_a_demand_keeps_its_direction_half_a_period_ahead(theta, omega, tracker, make_state):
    state = make_state((0.0, 0.0, theta), (0.0, 0.0, omega))
    wrench = tracker.obey(state, Demand(0.0, 0.3, -0.4, 0.0, 0.0, 0.0, 1.0), PERIOD)
    force = to_table(theta + 0.5 * PERIOD * omega, wrench.fx, wrench.fy)
    assert force == pytest.approx((0.3, -0.4))


def test_a_demand_holds_its_heading_like_a_reference(tracker, make_state):
    state = make_state((0.0, 0.0, 0.4), (0.0, 0.0, -0.1), (0.0, 0.0, 0.02))
    demand = Demand(0.0, 1.0, 0.0, 0.9, 0.05, 0.01, 1.0)
    expected = tracker.track(state, reference((0, 0, 0.9), (0, 0, 0.05), (0, 0, 0.01)))
    assert tracker.obey(state, demand, PERIOD).tau == expected.tau


# References in time


@given(dt=st.floats(-2.0, 2.0), other=st.floats(-2.0, 2.0))
def test_carried_forward_twice_is_carried_forward_once(dt, other):
    start = reference((1.0, -2.0, 0.3), (0.1, 0.2, -0.3), (0.01, -0.02, 0.05), t=5.0)
    there = carry_forward(carry_forward(start, 5.0 + dt), 5.0 + dt + other)
    once = carry_forward(start, 5.0 + dt + other)
    assert there.t == once.t
    assert there.accel == once.accel
    for one, two in ((there.pose, once.pose), (there.twist, once.twist)):
        fields = one.__struct_fields__
        assert [getattr(one, f) for f in fields] == pytest.approx(
            [getattr(two, f) for f in fields], abs=1e-12
        )


def test_carried_forward_at_constant_acceleration():
    start = reference((1.0, -2.0, 0.3), (0.1, 0.2, -0.3), (0.01, -0.02, 0.05), t=5.0)
    later = carry_forward(start, 7.0)
    assert (later.pose.x, later.pose.y, later.pose.theta) == pytest.approx((1.22, -1.64, -0.2))
    assert (later.twist.vx, later.twist.vy, later.twist.omega) == pytest.approx((0.12, 0.16, -0.2))


@pytest.mark.parametrize(
    ("t", "chosen"),
    [
        (0.9, 0),  # before the first: carried back
        (1.0, 0),
        (1.09, 0),
        (1.1 - 1e-10, 1),  # a tick that is late by rounding
        (1.1, 1),
        (1.15, 1),
        (1.2, 2),
        (9.0, 2),  # after the last: carried on
    ],
)
def test_due_is_the_last_reference_that_has_begun(t, chosen):
    references = tuple(
        reference((k, 0.0, 0.0), (0.1 * k, 0.0, 0.0), t=1.0 + 0.1 * k) for k in range(3)
    )
    found = due(Trajectory(references, 2.0), t)
    assert found == carry_forward(references[chosen], t)


# Stopping


@pytest.mark.parametrize("velocity", [(0.1, 0.0), (-0.06, 0.08), (0.0, -0.3), (0.0, 0.0)])
def test_brake_stands_where_a_steady_deceleration_ends(velocity, make_state):
    state = make_state((1.0, -1.0, 0.7), (*velocity, 0.2), t=4.0)
    stop, speed = brake(state, 0.05), math.hypot(*velocity)
    way = (stop.pose.x - 1.0, stop.pose.y + 1.0)
    assert math.hypot(*way) == pytest.approx(speed**2 / 0.1)
    assert way[0] * velocity[1] == pytest.approx(way[1] * velocity[0])
    assert way[0] * velocity[0] + way[1] * velocity[1] >= 0.0
    assert stop.pose.theta == 0.7
    assert stop.twist == Twist(0.0, 0.0, 0.0)
    assert stop.accel == Accel(0.0, 0.0, 0.0)
    assert stop.t == 4.0


def test_a_braking_vehicle_comes_to_rest_there(vehicle, tracker, make_state):
    stop = brake(make_state((0.0, 0.0, 0.0), (0.15, -0.1, 0.05)), PARAMS.brake_decel)
    path = fly(
        vehicle, lambda t, state: tracker.track(state, stop), make_state,
        [0.0, 0.0, 0.0, 0.15, -0.1, 0.05], (0.002, 0.0, 0.0), 400,
    )  # fmt: skip
    assert path[-1] == pytest.approx([stop.pose.x, stop.pose.y, 0.0, 0.0, 0.0, 0.0], abs=1e-9)
    beyond = path[:, 0] / stop.pose.x  # along the way
    assert beyond.max() < 1.3
