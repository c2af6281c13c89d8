"""Pulses against the duty they stand for, and against what a valve can do."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from sim_twin.board import Board, no_pulses
from stages import Modulator
from testbed.core.types import ValveCommand
from testbed.flight.modulation import (
    Carried,
    PwmParams,
    PwpfParams,
    SigmaDeltaParams,
    against_droop,
)
from testbed.flight.modulation import pulses as fired_pulses
from testbed.flight.plan import in_microseconds, planner_of

JETS = 8
KINDS = [PwmParams(), SigmaDeltaParams(), PwpfParams()]
CARRYING = [SigmaDeltaParams(), PwpfParams()]
HAIR = 1e-12  # [s]

duties = st.lists(st.floats(0.0, 1.0), min_size=JETS, max_size=JETS).map(np.array)
periods = st.sampled_from([0.02, 0.05, 0.1, 0.2, 0.5])
# of the period: config refuses more than 1
shares = st.floats(0.0, 1.0)


@pytest.fixture(scope="module")
def vehicle(vehicle):
    """With a stiff supply; the tests of droop set their own."""
    return with_droop(vehicle, 0.0)


def name(params):
    return type(params).__name__.removesuffix("Params").lower()


def with_valve(vehicle, **times):
    return replace(vehicle, valve=replace(vehicle.valve, **times))


def with_droop(vehicle, droop):
    return replace(vehicle, air=replace(vehicle.air, droop=droop))


def fire(modulator, duty, count):
    """On-times and offsets of `count` periods of the same duty, shape (count, jets)."""
    plans = [modulator.pulses(np.broadcast_to(duty, JETS).copy()) for _ in range(count)]
    return np.array([on for on, _ in plans]), np.array([offset for _, offset in plans])


def gaps(on, offset, period):
    """Times between two openings of one jet [s]; pulses that touch are one opening."""
    found = []
    for j in range(on.shape[1]):
        k = np.nonzero(on[:, j])[0]
        up, down = k * period + offset[k, j], k * period + offset[k, j] + on[k, j]
        gap = up[1:] - down[:-1]
        found += gap[gap > 1e-9].tolist()
    return np.array(found)


# All of them


@pytest.mark.parametrize("params", KINDS, ids=name)
@given(plan=st.lists(duties, min_size=1, max_size=8), period=periods, min_on=shares, min_off=shares)
def test_pulses_stay_inside_their_period(params, vehicle, plan, period, min_on, min_off):
    valved = with_valve(vehicle, min_on_s=min_on * period, min_off_s=min_off * period)
    modulator = Modulator(params, valved, period)
    for duty in plan:
        on, offset = modulator.pulses(duty)
        assert on.shape == offset.shape == (JETS,)
        assert (offset >= 0.0).all()
        assert (on >= 0.0).all()
        assert (offset + on <= period + HAIR).all()


@pytest.mark.parametrize("params", KINDS, ids=name)
@given(duty=duties)
def test_the_duty_handed_over_is_not_written_to(params, vehicle, duty):
    before = duty.tobytes()
    Modulator(params, vehicle, 0.1).pulses(duty)
    assert duty.tobytes() == before


@pytest.mark.parametrize("params", KINDS, ids=name)
def test_zero_duty_fires_nothing(params, vehicle):
    on, _ = fire(Modulator(params, vehicle, 0.1), 0.0, 50)
    assert (on == 0.0).all()


@pytest.mark.parametrize("params", KINDS, ids=name)
def test_full_duty_opens_for_good(params, vehicle):
    four = np.array([1.0] * 4 + [0.0] * 4)  # none against another
    on, _ = fire(Modulator(params, vehicle, 0.1), four, 50)
    assert (on[5:] == 0.1 * four).all()


@pytest.mark.parametrize("params", CARRYING, ids=name)
@given(plan=st.lists(duties, min_size=1, max_size=10))
def test_what_is_owed_is_bounded_and_soon_paid(params, vehicle, plan):
    modulator = Modulator(params, vehicle, 0.1)
    for duty in plan:
        modulator.pulses(duty)
    on, _ = fire(modulator, 0.0, 20)
    assert (on.sum(axis=0) <= 0.1 + HAIR).all()  # one period's worth
    assert (on[3:] == 0.0).all()


@pytest.mark.parametrize("params", [SigmaDeltaParams()], ids=name)
@given(plan=st.lists(duties, min_size=4, max_size=12), period=periods)
def test_openings_last_and_pauses_last(params, vehicle, plan, period):
    valve = vehicle.valve
    modulator = Modulator(params, vehicle, period)
    plans = [modulator.pulses(duty) for duty in plan]
    on, offset = np.array([p[0] for p in plans]), np.array([p[1] for p in plans])
    assert (on[on > 0.0] >= valve.min_on_s - HAIR).all()
    assert (gaps(on, offset, period) >= valve.min_off_s - HAIR).all()


# Pulse width


def nearest(wish, period, min_on, min_off):
    """By trying: 0, the whole period, or a centred pulse with a pause on either side."""
    longest = period - 2.0 * min_off
    allowed = [0.0, period]
    if longest >= min_on:
        allowed.append(min(max(wish, min_on), longest))
    return min(allowed, key=lambda on: abs(on - wish))


@pytest.mark.parametrize(
    ("min_on", "min_off"),
    [
        (0.010, 0.010),  # as shipped
        (0.0, 0.0),
        (0.030, 0.005),
        (0.010, 0.040),
        (0.010, 0.045),
        (0.100, 0.0),
        (0.010, 0.048),  # a pulse with its pauses does not fit: all or nothing
        (0.010, 0.060),
    ],
)
def test_pwm_gives_the_nearest_pulse_the_valve_can_do(min_on, min_off, vehicle):
    period = 0.1
    modulator = Modulator(
        PwmParams(), with_valve(vehicle, min_on_s=min_on, min_off_s=min_off), period
    )
    for duty in np.linspace(0.0, 1.0, 233):
        on, _ = modulator.pulses(np.full(JETS, duty))
        wish = duty * period
        best = nearest(wish, period, min_on, min_off)
        assert abs(on[0] - wish) == pytest.approx(abs(best - wish), abs=HAIR), duty


@pytest.mark.parametrize(
    ("duty", "on"),
    [
        (0.049, 0.0), (0.051, 0.01), (0.1, 0.01), (0.3, 0.03),
        (0.8, 0.08), (0.89, 0.08), (0.91, 0.1),
    ],
)  # fmt: skip
def test_pwm_has_a_dead_band_and_a_full_band(duty, on, vehicle):
    assert fire(Modulator(PwmParams(), vehicle, 0.1), duty, 1)[0][0, 0] == pytest.approx(on)


@pytest.mark.parametrize("params", [PwmParams(), SigmaDeltaParams()], ids=name)
@given(duty=duties)
def test_pulses_are_centred(params, vehicle, duty):
    on, offset = Modulator(params, vehicle, 0.1).pulses(duty)
    assert offset + 0.5 * on == pytest.approx(np.full(JETS, 0.05))


# Droop


def impulses(on, offset, droop, period):
    """Impulse of pulses in times of full thrust, by adding up slices of the period, (jets,)."""
    at = period * (np.arange(2000) + 0.5)[:, None] / 2000
    flows = (offset < at) & (at < offset + on)
    share = 1.0 / (1.0 + droop * np.maximum(flows.sum(axis=1) - 1, 0))
    return (flows * share[:, None]).mean(axis=0) * period


@given(duty=duties, droop=st.sampled_from([0.02, 0.2, 0.6]))
def test_pulses_give_their_impulse_while_others_flow(duty, droop):
    on = against_droop(duty / (1.0 + droop * (JETS - 1)), droop)  # room for all of it
    assert on.max() <= 1.0 + HAIR
    given = impulses(on, 0.5 * (1.0 - on), droop, 1.0)
    assert given * (1.0 + droop * (JETS - 1)) == pytest.approx(duty, abs=0.01)


@pytest.mark.parametrize("params", KINDS, ids=name)
@pytest.mark.parametrize("droop", [0.02, 0.2, 0.6])
def test_the_mean_impulse_is_kept_with_droop(params, droop, vehicle):
    duty, period = np.zeros(JETS), 0.1
    duty[[0, 1, 2, 3]] = 0.35, 0.2, 0.11, 0.05  # the last one fires every other period
    modulator = Modulator(params, with_droop(vehicle, droop), period)
    given = np.zeros(JETS)
    for _ in range(400):
        given += impulses(*modulator.pulses(duty), droop, period)
    error = np.abs(given / 400 / period - duty).max()
    assert error < {"pwm": 0.05, "sigmadelta": 1e-3, "pwpf": 0.015}[name(params)]


def test_a_saturated_jet_does_not_owe_what_droop_takes(vehicle):
    modulator, duty = Modulator(SigmaDeltaParams(), with_droop(vehicle, 0.5), 0.1), np.zeros(JETS)
    duty[[0, 1, 2]] = 1.0
    on, _ = fire(modulator, duty, 50)
    assert (on[:, :3] == 0.1).all()
    assert modulator.carried.rest == pytest.approx(np.zeros(JETS))


# Carried remainder


@given(duty=st.floats(0.0, 1.0), period=periods)
def test_sigma_delta_is_exact_on_average(vehicle, duty, period):
    one_jet = np.zeros(JETS)
    one_jet[3] = duty
    on, _ = fire(Modulator(SigmaDeltaParams(), vehicle, period), one_jet, 200)
    owed = duty * period * np.arange(1, 201) - np.cumsum(on[:, 3])
    assert np.abs(owed).max() <= vehicle.valve.min_on_s + HAIR
    assert (np.delete(on, 3, axis=1) == 0.0).all()


@given(plan=st.lists(duties, min_size=1, max_size=40), min_on=shares, min_off=shares)
def test_sigma_delta_keeps_the_impulse_of_any_valve(vehicle, plan, min_on, min_off):
    # net impulse of two opposing jets, because their remainders cancel; owed at most one period's
    modulator = Modulator(
        SigmaDeltaParams(), with_valve(vehicle, min_on_s=0.1 * min_on, min_off_s=0.1 * min_off), 0.1
    )
    asked, given = np.zeros(JETS), np.zeros(JETS)
    for duty in plan:
        # no more than a jet can repay
        asked += 0.1 * 0.5 * duty
        given += modulator.pulses(0.5 * duty)[0]
        for one, other in ((0, 5), (1, 4), (2, 7), (3, 6)):
            owed = (asked[one] - asked[other]) - (given[one] - given[other])
            assert abs(owed) <= 0.1 + HAIR


@given(duty=st.floats(0.0, 1.0))
def test_opposing_remainders_cancel(vehicle, duty):
    both = np.zeros(JETS)
    both[[0, 5]] = duty  # against each other
    on, _ = fire(Modulator(SigmaDeltaParams(), vehicle, 0.1), both, 20)
    assert (on == 0.0).all()


def test_a_remainder_is_paid_by_the_opposing_jet(vehicle):
    modulator = Modulator(SigmaDeltaParams(), vehicle, 0.1)
    first, second = np.zeros(JETS), np.zeros(JETS)
    first[0], second[5] = 0.09, 0.29
    assert (modulator.pulses(first)[0] == 0.0).all()  # 9 ms are owed
    on, _ = modulator.pulses(second)
    assert on[5] == pytest.approx(0.020)
    assert on[0] == 0.0


def test_opposing_jets_of_unequal_thrust_cancel_by_impulse(vehicle):
    jets = list(vehicle.jets)
    jets[5] = replace(jets[5], thrust=2.0 * jets[0].thrust)
    modulator = Modulator(SigmaDeltaParams(), replace(vehicle, jets=jets), 0.1)
    duty = np.zeros(JETS)
    duty[0], duty[5] = 0.8, 0.4
    assert (fire(modulator, duty, 5)[0] == 0.0).all()
    duty[0] = 0.2  # leaves an impulse of 0.6 jets 1, which is 0.3 jets 6
    assert fire(modulator, duty, 1)[0][0] == pytest.approx(0.03 * np.eye(JETS)[5])


# Lag filter and trigger


def pwpf_mean(vehicle, duty, period):
    on, _ = fire(Modulator(PwpfParams(), vehicle, period), duty, 1500)
    return on[500:].mean() / period


@pytest.mark.parametrize("period", [0.05, 0.1])
@pytest.mark.parametrize("duty", [0.03, 0.05, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.98])
def test_pwpf_static_gain(vehicle, duty, period):
    # the filter settles where gain (duty - mean) is half-way between the thresholds: 0.5 / 50
    assert pwpf_mean(vehicle, duty, period) == pytest.approx(duty - 0.01, abs=0.02)


@pytest.mark.parametrize("duty", [0.0, 0.01, 0.0199])
def test_pwpf_dead_band(vehicle, duty):
    assert pwpf_mean(vehicle, duty, 0.1) == 0.0


def test_pwpf_fires_just_outside_its_dead_band(vehicle):
    assert pwpf_mean(vehicle, 0.0205, 0.1) > 0.0


def test_pwpf_pulse_and_pause_at_half_duty(vehicle):
    # (trigger_on - trigger_off) lag / (gain / 2) = 50 ms each
    on, offset = fire(Modulator(PwpfParams(), vehicle, 0.1), 0.5, 500)
    assert on[100:].mean() == pytest.approx(0.050, abs=0.002)
    assert gaps(on[100:], offset[100:], 0.1).mean() == pytest.approx(0.050, abs=0.003)


def test_pwpf_is_the_filter_with_its_trigger(vehicle):
    # the analogue form integrated in steps of 10 us; at this duty no pulse meets a period's end
    p, step, period = PwpfParams(), 1e-5, 0.1
    ups, state, opened = [], 0.0, False
    for k in range(round(2.0 / step)):
        state += step * (p.gain * (0.06 - opened) - state) / p.lag_s
        if not opened and state >= p.trigger_on:
            opened = True
            ups.append(k * step)
        elif opened and state <= p.trigger_off:
            opened = False
    on, offset = fire(Modulator(p, vehicle, period), 0.06, round(ups[2] / period))
    fired = np.nonzero(on[:, 0])[0]
    starts = fired * period + offset[fired, 0]
    assert starts[:2] == pytest.approx(ups[:2], abs=1e-3)


@pytest.mark.parametrize("duty", [0.03, 0.05, 0.2])
def test_pwpf_pulses_last(vehicle, duty):
    on, _ = fire(Modulator(PwpfParams(), vehicle, 0.1), duty, 1000)
    assert (on[on > 0.0] >= vehicle.valve.min_on_s - HAIR).all()


@pytest.mark.parametrize("duty", [0.03, 0.3, 0.7, 0.95, 0.99])
def test_pwpf_pauses_last(vehicle, duty):
    on, offset = fire(Modulator(PwpfParams(), vehicle, 0.1), duty, 1000)
    assert (gaps(on, offset, 0.1) >= vehicle.valve.min_off_s - HAIR).all()


@pytest.mark.parametrize("duty", [0.3, 0.6, 0.9, 0.95])
@pytest.mark.parametrize("period", [0.02, 0.05, 0.1])
def test_pwpf_waits_for_the_pause_of_a_slow_valve(vehicle, duty, period):
    least = 0.8 * period
    on, offset = fire(
        Modulator(PwpfParams(), with_valve(vehicle, min_off_s=least), period), duty, 1000
    )
    assert (on > 0.0).any()
    assert (gaps(on, offset, period) >= least - HAIR).all()


@pytest.mark.parametrize("duty", [0.1, 0.5, 0.9])
def test_pwpf_fires_where_the_shortest_pulse_flows_for_more_than_a_period(vehicle, duty):
    slow = with_valve(
        vehicle, open_delay_s=0.005, close_delay_s=0.02, min_on_s=0.011, min_off_s=0.018
    )
    modulator = Modulator(PwpfParams(), slow, 0.02)
    modulator.p = planner_of(PwpfParams(), slow, 0.02).modulator
    assert modulator.p.min_on > 0.02
    on, _ = fire(modulator, duty, 2000)
    assert on.mean() / 0.02 == pytest.approx(duty, abs=0.05)


@pytest.mark.parametrize("duty", [0.05, 0.3, 0.6, 0.9])
@pytest.mark.parametrize("period", [0.02, 0.05, 0.1, 1 / 30, 1 / 60])
@pytest.mark.parametrize(
    ("opens", "closes"), [(0.003, 0.005), (0.012, 0.004), (0.006, 0.006)],
    ids=["closes slowly", "opens slowly", "alike"],
)  # fmt: skip
def test_the_board_plays_every_plan_of_pwpf(vehicle, duty, period, opens, closes):
    """Also pulses of several plans: once each, of the wanted time of flow."""
    slow = with_valve(
        vehicle, open_delay_s=opens, close_delay_s=closes, open_ramp_s=0.0, close_ramp_s=0.0
    )
    slow = replace(slow, command_delay_s=0.0)
    planner = planner_of(PwpfParams(), slow, period)
    carried, pulses = Carried(*np.zeros((3, JETS))), no_pulses(JETS)
    board, times = Board(slow, pulses, np.random.default_rng(0)), np.zeros(2 * JETS)
    wanted, planned, played = 0.0, 0.0, {}
    for k in range(400):
        on, offset = fired_pulses(planner.modulator, carried, np.full(JETS, duty), np.ones(JETS))
        in_microseconds(planner, on, offset, times)
        whole = times.astype(int).tolist()
        t = k * period
        board.apply(ValveCommand(k + 1, t, t + period, tuple(whole[:JETS]), tuple(whole[JETS:])))
        played |= dict(zip(pulses.up[0].tolist(), pulses.down[0].tolist(), strict=True))
        wanted, planned = wanted + on[0], planned + 1e-6 * whole[0]
    opened = {up: down for up, down in played.items() if up >= 0}
    total = 1e-9 * sum(down - up for up, down in opened.items())
    assert total == pytest.approx(planned, abs=2e-6 * 400)
    # a pulse cannot begin before its plan: half of what it should last longer may be missing
    flow = total + len(opened) * (closes - opens)
    assert abs(flow - wanted) <= period + 0.5 * len(opened) * abs(opens - closes)
