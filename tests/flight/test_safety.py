"""Safety on board: what becomes of a vehicle when something is wrong, and never an open valve."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from stages import Detectors, Safety, braking_wrench, longest_brake
from testbed.config import find, load
from testbed.config.shipped import shipped_faults
from testbed.core.codes import LATCHED, FaultReport, InhibitReason, Refusal, Response
from testbed.core.se2 import to_table
from testbed.core.types import (
    Demand,
    Health,
    Inputs,
    PoseSample,
    State,
    Vitals,
    Wrench,
)
from testbed.flight.ending import EndingParams
from testbed.flight.safety import AT_REST
from testbed.rig.chain import fence_of, make_agent

PERIOD = 0.1  # [s]
FOR_EVER = 1e6  # [s]
EXPERIMENT = load(find("hold"))
NAME = "sat1"
PUSH = Demand(0.0, 0.3, 0.0, 0.0, 0.0, 0.0, FOR_EVER)


def sample(t, x=0.0, y=0.0, theta=0.0):
    return PoseSample(t, x, y, theta)


# Stopping


@pytest.mark.parametrize("theta", [0.0, 1.0, -2.5])
@pytest.mark.parametrize("velocity", [(0.1, 0.0), (-0.05, 0.2), (0.003, 0.004)])
def test_a_stop_is_straight_against_the_velocity_and_within_the_jets(
    theta, velocity, vehicle, make_state
):
    state = make_state((0.0, 0.0, theta), (*velocity, 0.0))
    wrench = braking_wrench(state, vehicle, 0.08, PERIOD)
    ax, ay = (f / vehicle.mass for f in to_table(theta, wrench.fx, wrench.fy))
    speed = math.hypot(*velocity)
    assert math.hypot(ax, ay) == pytest.approx(min(0.08, speed / PERIOD))
    assert ax * velocity[1] - ay * velocity[0] == pytest.approx(0.0, abs=1e-12)
    assert ax * velocity[0] + ay * velocity[1] < 0.0


def test_a_stop_makes_up_for_the_slope_and_takes_the_spin_out(vehicle, make_state):
    state = make_state((0.0, 0.0, 0.0), (0.0, 0.0, 0.1), (0.002, -0.001, 0.01))
    wrench = braking_wrench(state, vehicle, 0.08, PERIOD)
    fx, fy = to_table(0.5 * PERIOD * 0.1, wrench.fx, wrench.fy)
    assert (fx, fy) == pytest.approx((-0.002 * vehicle.mass, 0.001 * vehicle.mass))
    assert wrench.tau == pytest.approx(vehicle.inertia * (-0.1 / 0.5 - 0.01))


# Detectors


def test_equal_poses_are_counted_over_ticks():
    repeats = Detectors()
    assert repeats.count_repeats([sample(0.0, 1.0), sample(0.1, 1.1)]) == 0
    assert repeats.count_repeats([sample(0.2, 1.1), sample(0.3, 1.1)]) == 2
    assert repeats.count_repeats([]) == 2
    assert repeats.count_repeats([sample(0.4, 1.1), sample(0.5, 1.2)]) == 0


def test_a_jump_is_measured_from_where_the_vehicle_should_be(make_state):
    before = make_state((1.0, 0.0, 0.0), (0.1, 0.0, 0.0), t=10.0)
    assert Detectors(before).jump([sample(10.1, 1.01)]) == pytest.approx(0.0)
    assert Detectors(before).jump([sample(10.1, 1.01, 0.3)]) == pytest.approx(0.3)
    assert Detectors().jump([sample(10.1, 9.0)]) == Detectors(before).jump([]) == 0.0


@pytest.mark.parametrize("offset", [-0.9, 0.9])
def test_a_step_of_the_clock_is_no_jump(make_state, offset):
    before = make_state((1.0, 0.0, 0.0), (0.1, 0.0, 0.0), t=10.0)
    seen = sample(10.1 - offset, 1.01)  # stamped by the other clock
    assert Detectors(before).jump([seen]) == pytest.approx(0.09)
    assert Detectors(before).jump([seen], offset) == pytest.approx(0.0)
    aside = sample(10.1 - offset, 1.01, 0.3)
    assert Detectors(before).jump([aside], offset) > 0.2


def test_whose_pose_it_is(make_state):
    others = {"b": make_state((2.0, 0.0, 0.0), t=10.0), "c": make_state((0.0, 2.0, 0.0), t=10.0)}
    assert Detectors.whose(2.2, [sample(10.0, 0.1, 2.0)], others) == "c"
    assert Detectors.whose(1.0, [sample(10.0, 1.0, 1.0)], others) is None
    assert Detectors.whose(0.01, [sample(10.0, 0.1, 2.0)], others) is None
    assert Detectors.whose(1.0, [], others) is None


# The watch's verdict


@pytest.fixture
def safety(vehicle):
    return Safety(vehicle, EXPERIMENT.table, shipped_faults(), 0.08)


def act(safety, state, t=0.0, vitals=None, wanted=Wrench(0.3, 0.0, 0.0), **changes):  # noqa: B008
    inputs = Inputs(t, True, (), PUSH, {}, Health(t, 0.5e6, 2e7), vitals=vitals or Vitals())
    inputs = replace(inputs, **changes)
    return safety.act(inputs, t + 0.008, state, PUSH, wanted, 1.0, "")


def test_a_healthy_demand_goes_through_as_it_is(safety, make_state):
    wanted = Wrench(0.3, 0.0, 0.0)
    acted = act(safety, make_state(), wanted=wanted)
    assert acted.commanded_wrench == wanted
    assert (acted.response, acted.fault, acted.inhibit_reason) == (Response.NONE, None, None)


def test_a_warning_changes_nothing(safety, make_state):
    state = replace(make_state(), pose_age=0.06)
    acted = act(safety, state)
    assert acted.holding == ("pose_stale",)
    assert (acted.response, acted.commanded_wrench, acted.inhibit_reason) == (
        Response.WARN, Wrench(0.3, 0.0, 0.0), None,
    )  # fmt: skip


def test_a_braking_vehicle_stops_and_then_shuts_its_valves_for_good(safety, make_state):
    moving = make_state((0.0, 0.0, 0.0), (0.05, 0.0, 0.0))
    gone = Vitals(operator_age=1.5)
    acted = act(safety, moving, vitals=gone)
    assert acted.braking
    assert acted.commanded_wrench.fx < 0.0
    still = make_state((0.0, 0.0, 0.0), (0.9 * AT_REST, 0.0, 0.0))
    stopped = act(safety, still, 1.0)
    assert not stopped.braking
    assert stopped.inhibit_reason == Refusal(InhibitReason.FAULT)
    assert stopped.fault.id == "operator_gone"
    assert (acted.air_off, stopped.air_off) == (False, True)
    # the operator is back, the vehicle drifts: it does not begin again
    again = act(safety, moving, 2.0)
    assert again.inhibit_reason is not None
    assert not again.braking


def test_a_stop_that_does_not_end_is_given_up(safety, make_state):
    moving, gone = make_state((0.0, 0.0, 0.0), (0.05, 0.0, 0.0)), Vitals(operator_age=1.5)
    assert act(safety, moving, 0.0, gone).braking
    longest = longest_brake(EndingParams(), 0.05, 0.08)
    assert act(safety, moving, longest - 0.05, gone).braking
    given_up = act(safety, moving, longest + 0.05, gone)
    assert (given_up.braking, given_up.air_off) == (False, True)


def edited(vehicle, name, **changes):
    table = shipped_faults()
    table = table | {name: replace(table[name], **changes)}
    return Safety(vehicle, EXPERIMENT.table, table, 0.08)


def test_the_second_stop_of_a_row_that_is_not_latched_is_a_stop_again(vehicle, make_state):
    safety = edited(vehicle, "operator_gone", latched=False)
    moving, gone = make_state((0.0, 0.0, 0.0), (0.05, 0.0, 0.0)), Vitals(operator_age=1.5)
    assert act(safety, moving, 0.0, gone).braking
    assert act(safety, moving, 1.0).inhibit_reason is None
    assert act(safety, moving, 100.0, gone).braking


def test_a_holding_vehicle_comes_to_rest_also_with_setpoints(vehicle, make_state):
    safety = edited(vehicle, "operator_gone", latched=False, response="hold")
    moving, gone = make_state((0.0, 0.0, 0.0), (0.05, 0.0, 0.0)), Vitals(operator_age=1.5)
    held = act(safety, moving, 0.0, gone)
    assert (held.response, held.inhibit_reason, held.braking) == (Response.HOLD, None, False)
    assert held.commanded_wrench == braking_wrench(moving, vehicle, 0.08, PERIOD)
    assert act(safety, moving, 0.1).commanded_wrench == Wrench(
        0.3, 0.0, 0.0
    )  # and goes on afterwards


def test_what_cannot_brake_coasts(safety):
    acted = act(safety, None, vitals=Vitals(operator_age=1.5))
    assert not acted.braking
    assert acted.inhibit_reason is not None


@pytest.mark.parametrize("response", ["coast", "land"])
def test_coasting_shuts_the_valves_at_once_and_landing_the_air_too(vehicle, make_state, response):
    safety = edited(vehicle, "board_silent", response=response)
    silent = Health(0.0, 0.5e6, 2e7, silent_s=1.0)
    acted = act(safety, make_state((0, 0, 0), (0.05, 0, 0)), health=silent)
    assert (acted.response.words, acted.braking) == (response, False)
    assert acted.fault.id == "board_silent"
    assert acted.air_off == (response == "land")


def test_a_reset_begins_anew(safety, make_state):
    act(safety, make_state(), vitals=Vitals(same_config=False))
    assert safety.latched == ("config_differs",)
    safety.reset()
    assert act(safety, make_state(), 1.0).inhibit_reason is None


def test_a_stuck_valve_is_not_inferred_from_poses_that_cannot_be_trusted(safety, make_state):
    def pushed(k):  # as by jet 6: it gives 0.048 m/s^2 and turns clockwise
        t = 0.1 * k
        return make_state(twist=(0.048 * t, 0.0, -0.27 * t), t=t)

    for k in range(30):
        acted = act(safety, replace(pushed(k), rejected=9), 0.1 * k)
    assert acted.fault is None
    for k in range(30, 60):
        acted = act(safety, pushed(k), 0.1 * k)
    assert acted.response == Response.LAND
    assert "jet 6 " in acted.fault.text


# Any sequence: no valve opens in a forbidden state


finite = st.floats(-1.0, 1.0)
wild = finite | st.sampled_from([math.nan, math.inf, -math.inf, 1e12])
ticks = st.fixed_dictionaries({
    "after": st.sampled_from([PERIOD, PERIOD, PERIOD, 0.3, 2.0]),
    "armed": st.sampled_from([True, True, True, False]),
    "poses": st.sampled_from(["good", "good", "good", "none", "far", "nan", "future"]),
    "setpoint": st.none() | st.builds(Demand, wild, wild, wild, wild, wild, wild, wild),
    "push": st.booleans(),
    "pressure": st.sampled_from([5e5, 5e5, 5e5, 1e5, 0.0, math.nan]),
    "vitals": st.just(Vitals())
    | st.builds(
        Vitals, session_ok=st.booleans(), operator_age=st.sampled_from([0.0, 2.0]),
        clock_offset=st.sampled_from([0.0, 0.3, math.nan]), late_s=st.sampled_from([0.0, 0.2]),
        disk_free=st.sampled_from([1e12, 0.0]), same_config=st.booleans(),
        law_error=st.sampled_from(["", "boom"]),
        fleet=st.sampled_from([None, FaultReport("broke", "broke", "b")]),
    ),
})  # fmt: skip


def inputs_of(t, tick):
    seen = {
        "good": [sample(t - 0.02 - 0.01 * k, 1e-4 * math.sin(9 * t + k)) for k in range(10)][::-1],
        "none": [], "far": [sample(t - 0.02, 2.0, 2.0)], "nan": [sample(t - 0.02, math.nan)],
        "future": [sample(t + 5.0)],
    }[tick["poses"]]  # fmt: skip
    setpoint = replace(PUSH, t=t, valid_until=t + 0.5) if tick["push"] else tick["setpoint"]
    health = Health(t, tick["pressure"], 2e7)
    return Inputs(t, tick["armed"], tuple(seen), setpoint, {}, health, vitals=tick["vitals"])


@settings(max_examples=150)
@given(sequence=st.lists(ticks, min_size=1, max_size=25))
def test_no_valve_opens_in_a_forbidden_state(sequence):
    agent, t, latched = make_agent(EXPERIMENT, NAME), 0.0, False
    gate, fence = EXPERIMENT.flight.gate, fence_of(EXPERIMENT, NAME)
    for tick in sequence:
        t += tick["after"]
        inputs = inputs_of(t, tick)
        outputs = agent.step(inputs)
        if not any(outputs.command.on_us):
            why = outputs.inhibit_reason
            latched = latched or (why is not None and why.code in LATCHED)
            continue
        state = outputs.state
        assert outputs.inhibit_reason is None
        assert not latched, "a fault that shut the valves was forgotten"
        assert inputs.armed
        assert state is not None
        assert outputs.response <= Response.BRAKE
        braking = outputs.response == Response.BRAKE
        assert state.pose_age <= (gate.blind_s if braking else gate.pose_timeout_s)
        assert braking or state.rejected <= gate.max_rejected
        assert abs(state.pose.x) <= fence[0]
        assert abs(state.pose.y) <= fence[1]
        assert all(
            math.isfinite(v) for v in (outputs.commanded_wrench.fx, outputs.commanded_wrench.fy)
        )
        assert math.isfinite(inputs.health.supply_pressure)
        if not braking:
            assert inputs.setpoint is not None
            assert inputs.vitals.session_ok
            assert t + 0.008 - inputs.setpoint.valid_until <= gate.link_timeout_s
            assert inputs.vitals.same_config
        assert max(on + o for on, o in zip(outputs.command.on_us, outputs.command.offset_us,
                                           strict=True)) <= 100_000  # fmt: skip
        assert isinstance(state, State)
