"""One vehicle's step: pure, shut when in doubt, and plans that give the wrench it wants."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from stages import agent_of
from testbed.config import find, load
from testbed.core.codes import InhibitReason, Refusal
from testbed.core.pulse import open_time, timing
from testbed.core.types import (
    Accel,
    Demand,
    Health,
    Inputs,
    Pose,
    PoseSample,
    Reference,
    Trajectory,
    Twist,
    Wrench,
)
from testbed.flight.agent import lead_time
from testbed.flight.gate import Fence
from testbed.flight.modulation import PwpfParams
from testbed.flight.parameters import FlightParams
from testbed.rig import chain

PARAMS = FlightParams()
PERIOD = PARAMS.jet_period_s
FENCE = Fence(2.8, 2.8)
FOR_EVER = 1e6  # [s]


def hold(pose=(0.0, 0.0, 0.0), t=0.0, valid_until=FOR_EVER):
    still = Reference(t, Pose(*pose), Twist(0.0, 0.0, 0.0), Accel(0.0, 0.0, 0.0))
    return Trajectory((still,), valid_until)


@pytest.fixture
def make_agent(vehicle, table):
    def make(built=vehicle, params=PARAMS):
        return agent_of(built, table, {}, params, FENCE)

    return make


@pytest.fixture
def make_inputs(vehicle):
    """Inputs of a vehicle that stands still and is seen 20 ms late, then `changes`.

    No camera says the very same twice.
    """

    def make(t, pose=(0.0, 0.0, 0.0), pressure=vehicle.air.set_pressure, **changes):
        x, *rest = pose
        seen = tuple(
            PoseSample(t - 0.02 - 0.01 * k, x + 1e-4 * (-1) ** k, *rest)
            for k in reversed(range(10))
        )
        health = Health(t, pressure, 20e6)
        return replace(Inputs(t, True, seen, hold(), {}, health), **changes)

    return make


def fly(agent, inputs):
    return [agent.step(one) for one in inputs]


def shut(outputs):
    return not any(outputs.command.on_us)


# Pure


def random_inputs(make_inputs, seed, count):
    """Whatever may come: drop-outs, late and wild poses, disarming, old and missing setpoints."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        t = k * PERIOD
        pose = (0.1 * math.sin(0.3 * t), 0.05 * t, 0.1)
        inputs = make_inputs(t, (np.array(pose) + 0.0002 * rng.normal(size=3)).tolist())
        if rng.random() < 0.1:
            inputs = replace(inputs, samples=inputs.samples[: rng.integers(0, 5)])
        if rng.random() < 0.1:
            inputs = replace(inputs, samples=(*inputs.samples, PoseSample(t - 0.01, 1.0, 1.0, 0.0)))
        if rng.random() < 0.1:
            inputs = replace(inputs, armed=False)
        match rng.integers(0, 5):
            case 0:
                inputs = replace(inputs, setpoint=None)
            case 1:
                inputs = replace(inputs, setpoint=hold((0.1, 0.2, 0.3), t, t - 0.3))
            case 2:
                inputs = replace(inputs, setpoint=Demand(t, 0.1, 0.2, 0.3, 0.0, 0.0, t + 0.5))
        yield inputs


@pytest.mark.parametrize("seed", range(5))
def test_the_same_inputs_give_the_same_outputs(seed, make_agent, make_inputs):
    inputs = list(random_inputs(make_inputs, seed, 60))
    assert fly(make_agent(), inputs) == fly(make_agent(), inputs)


def test_agents_share_nothing(make_agent, make_inputs):
    inputs = list(random_inputs(make_inputs, 7, 40))
    alone = fly(make_agent(), inputs)
    one, other = make_agent(), make_agent()
    together = []
    for k, each in enumerate(inputs):
        together.append(one.step(each))
        other.step(make_inputs(k * PERIOD, (1.0, 1.0, 1.0)))
    assert together == alone


# Shut


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"armed": False}, InhibitReason.NOT_ARMED),
        ({"samples": ()}, InhibitReason.NO_POSE_YET),
        ({"setpoint": None}, InhibitReason.NO_SETPOINT_YET),
        ({"armed": False, "samples": (), "setpoint": None}, InhibitReason.NOT_ARMED),
    ],
)
def test_no_valve_opens_before_all_is_there(change, reason, make_agent, make_inputs):
    agent = make_agent()
    for k in range(20):
        outputs = agent.step(replace(make_inputs(k * PERIOD, (0.5, 0.0, 0.0)), **change))
        assert shut(outputs)
        assert outputs.inhibit_reason == Refusal(reason)
        assert outputs.fault is None
        assert outputs.realised_wrench == Wrench(0.0, 0.0, 0.0)
    outputs = agent.step(make_inputs(20 * PERIOD, (0.5, 0.0, 0.0)))
    assert not shut(outputs)
    assert outputs.inhibit_reason is None


@pytest.mark.parametrize("seed", range(5))
def test_valves_open_only_while_the_gate_is_open(seed, make_agent, make_inputs):
    inputs = list(random_inputs(make_inputs, seed, 60))
    for given, outputs in zip(inputs, fly(make_agent(), inputs), strict=True):
        waits = not given.armed or given.setpoint is None or outputs.state is None
        assert (outputs.inhibit_reason is not None) >= waits
        assert outputs.inhibit_reason is None or shut(outputs)


def test_a_pulse_that_goes_on_is_shut_when_the_gate_shuts(make_agent, make_inputs):
    # PWPF opens for longer than a period and would end its pulse in the next
    agent = make_agent(params=replace(PARAMS, modulator=PwpfParams()))
    push = Demand(0.0, 1.2, 0.0, 0.0, 0.0, 0.0, FOR_EVER)
    assert not shut(fly(agent, [make_inputs(k * PERIOD, setpoint=push) for k in range(5)])[-1])
    outputs = agent.step(make_inputs(5 * PERIOD, setpoint=push, armed=False))
    assert shut(outputs)
    assert outputs.realised_wrench == Wrench(0.0, 0.0, 0.0)


def test_a_fault_shuts_the_valves_for_good(make_agent, make_inputs):
    agent = make_agent()
    agent.step(make_inputs(0.0))
    outputs = agent.step(make_inputs(PERIOD, samples=(PoseSample(0.09, 0.03, 0.0, 0.0),)))
    assert outputs.fault is None  # one strange pose is none
    for k in range(2, 10):  # the cameras fail
        outputs = agent.step(make_inputs(k * PERIOD, samples=()))
    assert outputs.fault.id == "pose_too_old"
    assert "no pose" in outputs.fault.text
    for k in range(10, 15):
        outputs = agent.step(make_inputs(k * PERIOD, (0.5, 0.0, 0.0)))
        assert shut(outputs)
        assert outputs.inhibit_reason.words == outputs.fault.text


def test_a_pose_stamped_in_the_future_does_not_blind_the_vehicle(make_agent, make_inputs):
    # one sample with a wrong stamp, then the vehicle drifts off at 0.1 m/s
    agent = make_agent()
    agent.step(make_inputs(0.0))
    agent.step(make_inputs(PERIOD, samples=(PoseSample(PERIOD + 5.0, 0.0, 0.0, 0.0),)))
    for k in range(2, 20):
        x = 0.01 * k
        outputs = agent.step(make_inputs(k * PERIOD, (x, 0.0, 0.0)))
    assert outputs.fault is None
    assert outputs.state.pose.x == pytest.approx(x, abs=0.02)


@pytest.mark.parametrize("period", [0.02, 0.05, 0.1])
def test_a_loss_of_poses_is_flown_through_on_what_was_fired(period):
    # a steady push, and nothing seen from 1 s on
    experiment = load(find("hold"), [f"flight.jet_period_s={period}", "faults={}"])
    setup = experiment.vehicles["sat1"]
    agent, a = chain.make_agent(experiment, "sat1"), 0.3 / setup.model.mass
    health = Health(0.0, setup.model.air.set_pressure, 20e6)
    push = Demand(0.0, 0.3, 0.0, 0.0, 0.0, 0.0, FOR_EVER)
    states = []
    for k in range(round(1.3 / period) + 1):
        t = k * period
        captured = np.arange(t - period, t, 0.01).tolist() if t < 1.0 else []
        seen = tuple(PoseSample(c, 0.5 * a * max(c, 0.0) ** 2, 0.0, 0.0) for c in captured)
        outputs = agent.step(Inputs(t, True, seen, push, {}, health))
        assert outputs.fault is None
        states.append(outputs.state)
    early, late = states[round(1.0 / period)], states[-1]
    assert late.pose_age > 0.3
    gained = late.twist.vx - early.twist.vx - 0.3 * late.bias.ax
    assert gained == pytest.approx(0.3 * a, rel=0.1)  # a pulse more or less


# Setpoints that run out


def test_a_setpoint_that_has_run_out_is_not_flown(make_agent, make_inputs):
    agent = make_agent()
    setpoint = hold((0.4, 0.0, 0.0), valid_until=0.25)
    for k in range(6):
        outputs = agent.step(make_inputs(k * PERIOD, (0.1, 0.0, 0.0), setpoint=setpoint))
        in_force = k * PERIOD + 0.008 <= 0.25
        assert outputs.active_setpoint.pose.x == pytest.approx(0.4 if in_force else 0.1, abs=0.02)
    # and it stands where it began to brake, whatever the estimate does afterwards
    stands = outputs.active_setpoint
    assert (
        agent.step(make_inputs(0.6, (0.13, 0.0, 0.0), setpoint=setpoint)).active_setpoint == stands
    )
    # until the next one comes
    fresh = hold((0.2, 0.0, 0.0))
    assert (
        agent.step(make_inputs(0.7, (0.1, 0.0, 0.0), setpoint=fresh)).active_setpoint.pose.x == 0.2
    )


def test_when_no_setpoint_comes_the_gate_gives_up(make_agent, make_inputs):
    agent, setpoint, faults = make_agent(), hold(valid_until=0.5), []
    for k in range(40):
        faults.append(agent.step(make_inputs(k * PERIOD, setpoint=setpoint)).fault)
    began = next(k for k, fault in enumerate(faults) if fault)
    assert began * PERIOD + 0.008 - 0.5 == pytest.approx(2.0, abs=PERIOD)
    assert "no setpoint" in faults[-1].text


def test_a_demand_is_flown_as_it_is(make_agent, make_inputs, vehicle):
    agent = make_agent()
    demand = Demand(0.0, 0.3, -0.2, 0.0, 0.0, 0.0, FOR_EVER)
    outputs = agent.step(make_inputs(0.0, setpoint=demand))
    assert outputs.active_setpoint == demand
    assert (outputs.commanded_wrench.fx, outputs.commanded_wrench.fy) == pytest.approx((0.3, -0.2))


# Plans


def test_plans_follow_each_other(make_agent, make_inputs):
    outputs = fly(make_agent(), [make_inputs(k * PERIOD) for k in range(10)])
    for k, one in enumerate(outputs):
        assert one.t == one.command.issued_at == k * PERIOD
        assert one.command.valid_until == pytest.approx((k + 1) * PERIOD)
        assert one.command.seq == outputs[0].command.seq + k


def test_the_state_is_that_of_the_moment_the_jets_take_effect(make_agent, make_inputs, vehicle):
    assert lead_time(vehicle) == pytest.approx(0.008)  # 2 ms to the board, 6 ms to flow
    outputs = make_agent().step(make_inputs(0.0))
    assert outputs.state.t == pytest.approx(0.008)
    assert outputs.state.pose_age == pytest.approx(0.02)


VALVES = {
    "shipped": {},
    "slow to open": {"open_delay_s": 0.012, "open_ramp_s": 0.006, "close_delay_s": 0.005},
    "slow to close": {"close_delay_s": 0.011, "close_ramp_s": 0.004},
}


def mean_flow(vehicle, command):
    """Duty of each jet that really flows, pulses taken one by one."""
    valve, flow = timing(vehicle.valve), []
    for on, offset in zip(command.on_us, command.offset_us, strict=True):
        up = 1e-6 * offset
        flow.append(open_time(up, up + 1e-6 * on, valve, -1.0, 1.0) / PERIOD if on else 0.0)
    return np.array(flow)


@pytest.mark.parametrize("valve", VALVES)
def test_pulses_give_the_wanted_impulse(valve, vehicle, make_agent, make_inputs):
    # valves that open and close at different speed are made up for
    built = replace(
        vehicle,
        valve=replace(vehicle.valve, **VALVES[valve]),
        air=replace(vehicle.air, droop=0.0),
    )
    demand = Demand(0.0, 0.45, -0.3, 0.0, 0.0, 0.0, FOR_EVER)
    agent = make_agent(built)
    outputs = agent.step(make_inputs(0.0, (0.0, 0.0, 0.1), setpoint=demand))
    flow = mean_flow(built, outputs.command)
    given = np.array([[*jet.push] for jet in built.jets]).T @ (flow * 0.6)
    assert given == pytest.approx(
        [outputs.commanded_wrench.fx, outputs.commanded_wrench.fy], abs=2e-5
    )


@pytest.mark.parametrize(
    ("valve", "force"),
    [
        ("shipped", 0.05),
        ("shipped", 0.95),
        ("slow to open", 0.05),
        ("slow to open", 0.95),
        ("slow to close", 0.05),
        ("slow to close", 0.95),
    ],
)
def test_pulses_give_the_wanted_impulse_in_the_long_run(
    valve, force, vehicle, make_agent, make_inputs
):
    # the shortest and the longest pulse of a valve come up again and again
    built = replace(
        vehicle,
        valve=replace(vehicle.valve, **VALVES[valve]),
        air=replace(vehicle.air, droop=0.0),
    )
    demand = Demand(0.0, force, 0.0, 0.0, 0.0, 0.0, FOR_EVER)
    agent = make_agent(built)
    plans = fly(agent, [make_inputs(k * PERIOD, setpoint=demand) for k in range(200)])
    impulse = sum(0.6 * PERIOD * mean_flow(built, one.command).sum() for one in plans)
    # near saturation a period that is open throughout cannot be lengthened: some percent are lost
    assert impulse == pytest.approx(force * 200 * PERIOD, rel=0.05 if force > 0.5 else 0.03)


def test_droop_is_made_up_for(vehicle, make_agent, make_inputs):
    demand = Demand(0.0, 0.4, 0.0, 0.0, 0.0, 0.0, FOR_EVER)
    outputs = make_agent().step(make_inputs(0.0, setpoint=demand))
    flow = mean_flow(vehicle, outputs.command)
    assert np.count_nonzero(flow) == 2
    thrust = 0.6 / (1.0 + vehicle.air.droop)  # of two open jets
    assert flow.sum() * thrust == pytest.approx(0.4, abs=1e-5)


@pytest.mark.parametrize("share", [0.3, 0.7, 1.0])
def test_low_pressure_is_made_up_for(share, vehicle, make_agent, make_inputs):
    demand = Demand(0.0, 0.2, 0.0, 0.0, 0.0, 0.0, FOR_EVER)
    pressure = share * vehicle.air.set_pressure
    outputs = make_agent().step(make_inputs(0.0, setpoint=demand, pressure=pressure))
    flow = mean_flow(vehicle, outputs.command)
    assert flow.sum() * 0.6 * share / (1.0 + vehicle.air.droop) == pytest.approx(0.2, abs=1e-5)
    assert outputs.realised_wrench.fx == pytest.approx(0.2, abs=1e-5)


def test_a_pressure_that_is_not_a_number_does_not_ground_the_vehicle_in_silence(
    make_agent, make_inputs
):
    demand = Demand(0.0, 0.4, 0.0, 0.0, 0.0, 0.0, FOR_EVER)
    outputs = make_agent().step(make_inputs(0.0, setpoint=demand, pressure=math.nan))
    assert not shut(outputs) or outputs.inhibit_reason is not None


@pytest.mark.parametrize("droop", [0.0, 0.02, 0.3])
def test_the_realised_wrench_is_what_the_jets_give(droop, make_agent, make_inputs, vehicle):
    built = replace(vehicle, air=replace(vehicle.air, droop=droop))
    demand = Demand(0.0, 0.4, 0.28, 0.0, 0.0, 0.0, FOR_EVER)  # no pulse is too short
    outputs = make_agent(built).step(make_inputs(0.0, setpoint=demand))
    flow = mean_flow(built, outputs.command)
    assert np.count_nonzero(flow) > 2
    given = (outputs.realised_wrench.fx, outputs.realised_wrench.fy)
    assert given == pytest.approx((0.4, 0.28), rel=0.02 if droop else 1e-4)
    pushes = np.array([jet.push for jet in vehicle.jets]).T
    assert (np.hypot(*(0.6 * pushes @ flow)) > 1.01 * np.hypot(*given)) == (droop > 0.0)


@pytest.mark.parametrize(
    "valve",
    [
        "shipped",
        "slow to open",
        "slow to close",
    ],
)
def test_a_plan_is_what_the_board_can_play(valve, vehicle, make_agent, make_inputs):
    built = replace(vehicle, valve=replace(vehicle.valve, **VALVES[valve]))
    rng, agent, plans = np.random.default_rng(0), make_agent(built), []
    for k in range(300):
        fx, fy, theta = (rng.choice([0.2, 2.0]) * rng.uniform(-1.0, 1.0, 3)).tolist()
        demand = Demand(0.0, fx, fy, theta, 0.0, 0.0, FOR_EVER)
        command = agent.step(make_inputs(k * PERIOD, setpoint=demand)).command
        plans.append((command.offset_us, command.on_us))
    offset, on = np.array(plans).transpose(1, 0, 2)
    period = round(1e6 * PERIOD)
    assert (offset >= 0).all()
    assert (on + offset <= period).all()
    assert (on[on > 0] >= round(1e6 * built.valve.min_on_s)).all()
    for j in range(8):
        fired = np.nonzero(on[:, j])[0]
        up = fired * period + offset[fired, j]
        pause = up[1:] - (up + on[fired, j])[:-1]
        # pulses that touch are one opening; times are rounded to microseconds
        assert ((pause == 0) | (pause >= round(1e6 * built.valve.min_off_s) - 1)).all()
