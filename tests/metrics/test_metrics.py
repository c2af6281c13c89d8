"""What a flight was worth, against closed forms; what does not apply is null, never 0."""

import math
from itertools import pairwise

import numpy as np
import pytest

from testbed.core.table import Obstacle
from testbed.core.types import (
    Accel,
    Demand,
    Outputs,
    Pose,
    Reference,
    State,
    Twist,
    ValveCommand,
    Wrench,
)
from testbed.metrics.run_metrics import (
    HOLD_S,
    SETTLED_M,
    Aim,
    Consumption,
    Criteria,
    ReferenceLog,
    Track,
    VehicleMetrics,
    judge,
    obstacle_distances,
    settle_time,
    smallest_separation,
    vehicle_metrics,
)
from testbed.report.page import ROWS

LIMITS = [
    name
    for name in Criteria.__struct_fields__
    if name not in ("max_contacts", "clear_of_obstacles", "formation")
]
GOAL = (0.0, 0.0, 0.0)
NOTHING_SPENT = Consumption(0.0, 0.0, 0)
NO_AIM = Aim(np.zeros(0), np.zeros((0, 3)), np.zeros(0))


def moving(t, x, y, theta=lambda t: 0 * t, rates=None) -> Track:
    """One vehicle on a given path; rates by central differences unless given."""
    h = 1e-5
    paths = (x, y, theta)
    rates = rates or [lambda t, f=f: (f(t + h) - f(t - h)) / (2 * h) for f in paths]
    return Track(t, np.stack([f(t) for f in (*paths, *rates)], axis=1)[:, None, :])


def still(t, *places) -> Track:
    """Vehicles that stand at (x, y)."""
    states = np.zeros((len(t), len(places), 6))
    states[:, :, :2] = places
    return Track(t, states)


def judged(
    track: Track, aimed: Aim = NO_AIM, goal=GOAL, obstacles=None, completed_s: float | None = None
) -> VehicleMetrics:
    distances = obstacle_distances(track, 0, obstacles or {})
    if completed_s is None:
        completed_s = track.t[-1] if len(track.t) else 0.0
    return vehicle_metrics(track, 0, goal, aimed, NOTHING_SPENT, distances, completed_s)


def aimed_at(t, x=0.0, y=0.0, theta=0.0, force=0.0) -> Aim:
    one = np.ones_like(t)
    return Aim(t, np.stack([x * one, y * one, theta * one], axis=1), force * one)


# Settling


@pytest.mark.parametrize(
    ("error", "settled"),
    [
        ([0.0, 0.0, 0.0], 10.0),  # from the start
        ([1.0, 0.0, 0.0], 11.0),
        ([1.0, 0.0, 1.0], None),  # leaves again
        ([1.0, 1.0, 0.0], 12.0),
        ([0.0, 0.0, 1.0], None),
        ([1.0, 1.0, 1.0], None),
        ([SETTLED_M, SETTLED_M, SETTLED_M], 10.0),
        ([0.0, math.nextafter(SETTLED_M, 1.0), 0.0], 12.0),
        ([0.0, math.nan, 0.0], 12.0),
        ([0.0, 0.0, math.nan], None),
    ],
)
def test_settle_time(error, settled):
    assert settle_time(np.array([10.0, 11.0, 12.0]), np.array(error)) == settled


def test_a_decay_settles_when_the_closed_form_says():
    t = np.arange(0.0, 100.0, 0.01)
    tau = 12.0
    metrics = judged(moving(t, lambda t: np.exp(-t / tau), lambda t: 0 * t))
    assert metrics.settle_s == pytest.approx(tau * math.log(1.0 / SETTLED_M), abs=0.01)
    assert metrics.final_error_m == pytest.approx(math.exp(-t[-1] / tau))


# Interpolation


def test_interpolation_is_exact_for_cubics():
    t = np.array([0.0, 0.3, 1.0, 1.1, 2.0])
    cubics = [np.polynomial.Polynomial(c) for c in ([1, -2, 3, 0.5], [0, 1, 0, -1], [2, 0, -1, 1])]
    track = moving(t, *cubics, rates=[c.deriv() for c in cubics])
    times = np.linspace(0.0, 2.0, 101)
    exact = np.stack([c(times) for c in cubics], axis=1)
    np.testing.assert_allclose(track.at(times, 0), exact, rtol=0, atol=1e-13)


def test_interpolation_is_of_fourth_order():
    times = np.linspace(0.0, 6.0, 997)
    errors = []
    for n in (61, 121, 241):
        rates = [np.cos, lambda t: -np.sin(t), lambda t: 0 * t]
        track = moving(np.linspace(0.0, 6.0, n), np.sin, np.cos, rates=rates)
        exact = np.stack([np.sin(times), np.cos(times)], axis=1)
        errors.append(np.abs(track.at(times, 0)[:, :2] - exact).max())
    assert errors[0] < 0.1**4 / 384 * 1.01  # h^4 / 384 max |x''''|
    for coarse, fine in pairwise(errors):
        assert math.log2(coarse / fine) == pytest.approx(4.0, abs=0.15)


def test_interpolation_hits_the_samples():
    t = np.linspace(0.0, 3.0, 31)
    track = moving(t, np.sin, np.cos, np.exp)
    np.testing.assert_allclose(track.at(t, 0), track.states[:, 0, :3], rtol=0, atol=1e-15)


# RMS


def test_tracking_rms_of_a_circle_beside_its_reference():
    t = np.linspace(0.0, 20.0, 2001)
    track = moving(t, lambda t: 0.003 * np.cos(t), lambda t: 0.004 * np.sin(t))
    whole_turns = np.linspace(0.0, 6 * np.pi, 301)[:-1]
    metrics = judged(track, aimed_at(whole_turns))
    assert metrics.track_rms_m == pytest.approx(math.sqrt((0.003**2 + 0.004**2) / 2), rel=1e-6)


def test_references_outside_the_track_are_not_judged():
    track = still(np.linspace(1.0, 2.0, 101), (0.0, 0.0))
    t = np.array([0.5, 1.0, 1.5, 2.0, 2.5])
    pose = np.array([[9.0, 9, 9], [0.003, 0, 0], [0.003, 0, 0], [0.003, 0, 0], [9, 9, 9]])
    metrics = judged(track, Aim(t, pose, np.zeros(5)))
    assert metrics.track_rms_m == pytest.approx(0.003)
    assert metrics.heading_rms_deg == 0.0


def test_heading_error_is_taken_the_short_way_round():
    t = np.linspace(0.0, 1.0, 11)
    track = moving(t, lambda t: 0 * t, lambda t: 0 * t, lambda t: 0 * t + math.radians(179.5))
    metrics = judged(track, aimed_at(t, theta=math.radians(-179.5)))
    assert metrics.heading_rms_deg == pytest.approx(1.0)
    assert judged(track, aimed_at(t, theta=math.radians(179.5 - 720))).heading_rms_deg < 1e-9


# Holding


def test_holding_is_judged_in_the_last_thirty_seconds():
    t = np.arange(0.0, 100.0 + 1e-9, 0.01)
    track = moving(t, lambda t: np.where(t > 100.0 - HOLD_S, 0.002, 1.0), lambda t: 0 * t)
    assert judged(track).hold_rms_m == pytest.approx(0.002)
    track = moving(t, lambda t: np.where(t > 100.0 - HOLD_S - 0.015, 1.0, 0.0), lambda t: 0 * t)
    assert judged(track).hold_rms_m == pytest.approx(1.0)


def test_a_short_run_has_not_held():
    t = np.arange(0.0, HOLD_S, 0.01)
    assert judged(still(t, (0.0, 0.0))).hold_rms_m is None
    assert judged(still(np.append(t, HOLD_S), (0.003, 0.004))).hold_rms_m == pytest.approx(0.005)


def test_a_run_of_thirty_seconds_has_held_though_its_last_frame_is_before_its_end():
    track = still(np.arange(0.0, HOLD_S - 0.005, 0.01), (0.003, 0.004))
    assert judged(track, completed_s=sum([0.1] * 300)).hold_rms_m == pytest.approx(0.005)
    assert judged(track, completed_s=HOLD_S - 0.01).hold_rms_m is None
    assert judged(track, completed_s=0.0).hold_rms_m is None  # a fault ended it


def test_holding_is_about_the_place_not_the_heading():
    t = np.linspace(0.0, 60.0, 601)
    assert judged(still(t, (1.0, 2.0)), goal=(1.0, 2.0, 1.5)).hold_rms_m == 0.0


def test_settled_is_about_the_place_and_its_label_says_the_bound():
    t = np.linspace(0.0, 40.0, 401)
    metrics = judged(moving(t, lambda t: 0 * t, lambda t: 0 * t, theta=lambda t: 0.3 * t))
    assert metrics.settle_s == 0.0
    (label,) = [heading for heading, key, *_ in ROWS if key == "settle_s"]
    assert label == f"settled to {1e3 * SETTLED_M:g} mm [s]"


# Distances


def test_a_moving_obstacle_is_met_where_it_is():
    t = np.linspace(0.0, 10.0, 1001)
    track = moving(t, lambda t: 0 * t, lambda t: 0 * t)
    rock = Obstacle((-5.0, 0.3), 0.2, velocity=(1.0, 0.0))
    distances = obstacle_distances(track, 0, {"far": Obstacle((3.0, 4.0), 1.0), "passing": rock})
    assert distances == pytest.approx({"far": 5.0, "passing": 0.3})
    metrics = judged(track, obstacles={"far": Obstacle((3.0, 4.0), 1.0), "passing": rock})
    assert metrics.min_obstacle_distance_m == pytest.approx(0.3)


def test_smallest_separation_of_three():
    t = np.linspace(0.0, 1.0, 5)
    track = still(t, (0.0, 0.0), (3.0, 4.0), (3.0, 2.0))
    assert smallest_separation(track) == 2.0


# Null


def test_null_where_nothing_applies():
    t = np.linspace(0.0, 1.0, 11)
    metrics = judged(still(t, (1.0, 0.0)))
    assert metrics == VehicleMetrics(
        final_error_m=1.0, settle_s=None, track_rms_m=None, hold_rms_m=None, heading_rms_deg=None,
        min_obstacle_distance_m=None, impulse_ns=0.0, gas_g=0.0, valve_pulses=0, max_force_n=None,
        filtered_ns=0.0,
    )  # fmt: skip
    assert smallest_separation(still(t, (0.0, 0.0))) is None


@pytest.mark.parametrize("frames", [0, 1])
@pytest.mark.parametrize("vehicles", [1, 3])
def test_a_run_that_ended_before_it_began(frames, vehicles):
    track = still(np.zeros(frames), *[(float(k), 0.0) for k in range(vehicles)])
    metrics = judged(track, aimed_at(np.zeros(1)), obstacles={"o": Obstacle((1.0, 0.0), 0.5)})
    assert metrics.track_rms_m is None
    assert metrics.heading_rms_deg is None
    assert metrics.hold_rms_m is None
    assert (metrics.final_error_m is None) == (frames == 0)
    assert (metrics.min_obstacle_distance_m is None) == (frames == 0)
    assert (smallest_separation(track) is None) == (frames == 0 or vehicles == 1)


def output(t: float, flown, wanted=(0.0, 0.0), seen: bool = True) -> Outputs:
    zero = Accel(0.0, 0.0, 0.0)
    state = State(t, Pose(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0), zero, 0.0, 0)
    command = ValveCommand(1, t, t + 0.1, (0,), (0,))
    wrench, planned = Wrench(*wanted, 0.0), Wrench(0.0, 0.0, 0.0)
    return Outputs(t, state if seen else None, flown, wrench, planned, command, None, None)


def reference(t: float, x: float = 0.0, theta: float = 0.0) -> Reference:
    return Reference(t, Pose(x, 0.0, theta), Twist(0.0, 0.0, 0.0), Accel(0.0, 0.0, 0.0))


def demand(t: float, theta: float = 0.0) -> Demand:
    return Demand(t, 0.1, 0.0, theta, 0.0, 0.0, t + 0.5)


def test_aim_takes_the_ticks_that_had_a_setpoint():
    outputs = [
        output(0.0, None), output(0.1, reference(0.1), seen=False),
        output(0.2, reference(0.2, 1.0, 2.0), (0.3, -0.4)),
    ]  # fmt: skip
    aimed = ReferenceLog(outputs).aim()
    assert aimed.t.tolist() == [0.2]
    assert aimed.pose.tolist() == [[1.0, 0.0, 2.0]]
    assert aimed.force.tolist() == [0.5]
    assert ReferenceLog().aim().pose.shape == (0, 3)


def test_in_wrench_mode_there_is_a_heading_to_track_but_no_place():
    t = np.linspace(0.0, 1.0, 11)
    outputs = [output(k, demand(k, 0.01)) for k in t.tolist()]
    metrics = judged(still(t, (0.0, 0.0)), ReferenceLog(outputs).aim())
    assert metrics.track_rms_m is None
    assert metrics.heading_rms_deg == pytest.approx(math.degrees(0.01))


def test_braking_in_wrench_mode_is_not_tracking():
    t = np.linspace(0.0, 1.0, 11)
    flown = [output(k, demand(k)) for k in t[:8].tolist()]
    flown += [output(k, reference(k, 0.2)) for k in t[8:].tolist()]
    assert judged(still(t, (0.0, 0.0)), ReferenceLog(flown).aim()).track_rms_m is None


def test_largest_force():
    t = np.linspace(0.0, 1.0, 11)
    aimed = ReferenceLog(output(k, reference(k), (0.3 * k, 0.4 * k)) for k in t.tolist()).aim()
    assert judged(still(t, (0.0, 0.0)), aimed).max_force_n == pytest.approx(0.5)


# Criteria


def flight(**changes) -> VehicleMetrics:
    return VehicleMetrics(
        **{
            "final_error_m": 0.001, "settle_s": 50.0, "track_rms_m": 0.001, "hold_rms_m": 0.001,
            "heading_rms_deg": 0.05, "min_obstacle_distance_m": 0.9, "impulse_ns": 10.0,
            "gas_g": 10.0, "valve_pulses": 100, "max_force_n": 0.5,
        } | changes
    )  # fmt: skip


def test_only_criteria_that_are_given_are_judged():
    assert judge(Criteria(), {"a": flight()}, 0, True) == {
        "max_contacts": True, "clear_of_obstacles": True,
    }  # fmt: skip
    loose = Criteria(max_contacts=None, clear_of_obstacles=False)
    assert judge(loose, {"a": flight()}, 9, False) == {}


@pytest.mark.parametrize("name", LIMITS)
def test_a_limit_holds_for_every_vehicle_and_includes_itself(name):
    criteria = Criteria(**{name: 0.25})
    at, above = math.nextafter(0.25, 0.0), math.nextafter(0.25, 1.0)
    for values, met in (((0.25, at), True), ((0.25, above), False), ((above, 0.25), False)):
        vehicles = {k: flight(**{name: value}) for k, value in zip("ab", values, strict=True)}
        assert judge(criteria, vehicles, 0, True)[name] is met


@pytest.mark.parametrize("name", ["settle_s", "hold_rms_m", "heading_rms_deg", "final_error_m"])
def test_what_does_not_apply_is_not_met(name):
    vehicles = {"a": flight(), "b": flight(**{name: None})}
    assert judge(Criteria(**{name: 1e9}), vehicles, 0, True)[name] is False


def test_tracking_is_not_judged_without_references():
    nobody = {"a": flight(track_rms_m=None), "b": flight(track_rms_m=None)}
    assert "track_rms_m" not in judge(Criteria(track_rms_m=1.0), nobody, 0, True)
    one = {"a": flight(track_rms_m=None), "b": flight()}
    assert judge(Criteria(track_rms_m=1.0), one, 0, True)["track_rms_m"] is False


@pytest.mark.parametrize(
    ("allowed", "contacts", "met"), [(0, 0, True), (0, 1, False), (2, 2, True), (2, 3, False)]
)
def test_contacts_up_to_the_limit_meet_the_criterion(allowed, contacts, met):
    assert judge(Criteria(max_contacts=allowed), {}, contacts, True)["max_contacts"] is met
