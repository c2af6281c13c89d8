"""The time of flow is what comes out of the valves, not for how long they are commanded."""

import numpy as np
import pytest
from msgspec.structs import replace

from sim_twin.board import Board, no_pulses
from sim_twin.flow import pieces
from stages import Flow
from testbed.core.pulse import open_time, timing
from testbed.core.types import ValveCommand
from testbed.flight.fired import Fired, mean_wrench, model_of, note

PERIOD = 0.1  # [s]
SLOW = {"open_delay_s": 0.025, "close_delay_s": 0.015, "open_ramp_s": 0.004, "close_ramp_s": 0.002}


def plans(rng, jets, count):
    """Plans of the kind that a chain sends: nothing, a centred pulse, the whole period."""
    for k in range(count):
        on = rng.choice([0, 30_000, 65_000, 100_000], jets) + rng.integers(0, 100, jets)
        on = np.where(on < 1000, 0, np.minimum(on, 100_000)) if k < count - 1 else 0 * on
        t = k * PERIOD
        offset = (100_000 - on) // 2
        yield ValveCommand(k, t, t + PERIOD, tuple(on.tolist()), tuple(offset.tolist()))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("change", [{}, SLOW], ids=["shipped", "slow"])
def test_shares_add_up_to_what_flows_out_of_the_boards_pulses(seed, change, vehicle):
    valve = replace(vehicle.valve, **change)
    vehicle = replace(vehicle, valve=valve, command_delay_s=0.0)
    jets, rng = len(vehicle.jets), np.random.default_rng(seed)
    pulses = no_pulses(jets)
    board, flow = Board(vehicle, pulses, np.random.default_rng(0)), Flow(vehicle, PERIOD)
    told, played = np.zeros(jets), {}
    for command in plans(rng, jets, 40):
        told += PERIOD * flow.of(command)[0]
        board.apply(command)
        played |= {
            (j, up): down
            for j in range(jets)
            for up, down in zip(pulses.up[j].tolist(), pulses.down[j].tolist(), strict=True)
            if down > up  # what goes on has the same beginning and a later end
        }
    flowed = np.zeros(jets)
    for (j, up), down in played.items():
        flowed[j] += open_time(1e-9 * up, 1e-9 * down, timing(valve), 0.0, np.inf)
    np.testing.assert_allclose(told, flowed, atol=1e-6)


def test_a_slow_valve_lets_less_through_than_it_is_commanded(vehicle):
    vehicle = replace(vehicle, valve=replace(vehicle.valve, **SLOW))
    flow, none = Flow(vehicle, PERIOD), (0,) * 7
    short = ValveCommand(0, 0.0, PERIOD, (30_000, *none), (35_000, *none))
    assert flow.of(short)[0, 0] == pytest.approx((0.030 - 0.025 + 0.015 - 0.001) / PERIOD)


def test_what_a_pulse_loses_counts_in_its_last_plan_unless_it_goes_on(vehicle):
    vehicle = replace(vehicle, valve=replace(vehicle.valve, **SLOW))
    flow, none = Flow(vehicle, PERIOD), (0,) * 7
    whole = ValveCommand(0, 0.0, PERIOD, (100_000, *none), (0, *none))
    shut = ValveCommand(1, PERIOD, 2 * PERIOD, (0, *none), (0, *none))
    told = [flow.of(plan)[0, 0] for plan in (whole, whole, shut, shut)]
    assert told == pytest.approx([1.0 - 0.011 / PERIOD, 1.0, 0.0, 0.0])


def test_the_gas_of_a_valve_that_closes_slowly_counts_when_it_comes(vehicle):
    valve = replace(vehicle.valve, open_delay_s=0.005, close_delay_s=0.025)
    flow, none = Flow(replace(vehicle, valve=valve), PERIOD), (0,) * 7
    late = ValveCommand(0, 0.0, PERIOD, (30_000, *none), (65_000, *none))
    shut = ValveCommand(1, PERIOD, 2 * PERIOD, (0, *none), (0, *none))
    told = [flow.of(plan)[0, 0] for plan in (late, shut, shut)]
    assert told == pytest.approx([0.034 / PERIOD, 0.016 / PERIOD, 0.0])


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("opens", "closes"), [(0.006, 0.006), (0.025, 0.004), (0.004, 0.025)])
def test_a_plans_share_is_what_the_estimate_gains_by_it(seed, opens, closes, vehicle):
    valve = replace(vehicle.valve, open_delay_s=opens, close_delay_s=closes)
    vehicle = replace(vehicle, valve=valve, air=replace(vehicle.air, droop=0.0))
    jets, model = len(vehicle.jets), model_of(vehicle)
    plain = [np.full(60, -np.inf) for _ in range(2)], [np.zeros((60, jets)) for _ in range(3)]
    fired = Fired(*plain[0], *plain[1], np.ones(jets), np.zeros(jets))
    flow, flowed, before = Flow(vehicle, PERIOD), np.zeros(jets), np.zeros(jets)
    for command in plans(np.random.default_rng(seed), jets, 30):
        start, end = command.issued_at, command.valid_until
        note(fired, start, end, np.array(command.on_us + command.offset_us, float))
        # the estimate for the period's end knows no later plan
        mean_wrench(fired, model, flowed, 0.0, end + opens)
        np.testing.assert_allclose(PERIOD * flow.of(command)[0], flowed - before, atol=1e-6)
        before[:] = flowed


STEP = 0.01  # the estimator's [s]


def flown(vehicle, seed, count):
    """What the jets give in each step, by the twin and by the estimator, and each plan's shares."""
    jets, rng, model = len(vehicle.jets), np.random.default_rng(seed), model_of(vehicle)
    valve, thrust = np.array(timing(vehicle.valve)), np.hypot(*model.effect[:2])
    plain = [np.full(6, -np.inf) for _ in range(2)], [np.zeros((6, jets)) for _ in range(3)]
    fired = Fired(*plain[0], *plain[1], np.ones(jets), np.zeros(jets))
    pulses, flow, alone = no_pulses(jets), Flow(vehicle, PERIOD), np.zeros(jets)
    board = Board(vehicle, pulses, np.random.default_rng(0))
    true, believed, shares = [], [], []
    for command in plans(rng, jets, count):
        board.apply(command)
        times, t = np.array(command.on_us + command.offset_us, float), command.issued_at
        note(fired, t, t + PERIOD, times)
        shares.append(flow.of(command))
        origin = round(1e9 * t)
        for k in range(round(PERIOD / STEP)):
            a, b = t + k * STEP, t + (k + 1) * STEP
            start, value, slope = pieces(
                pulses, valve, model.effect, thrust, model.droop, np.zeros(jets),
                origin + round(1e9 * k * STEP), STEP,
            )  # fmt: skip
            h = np.diff(start)
            true.append(((value[:, :3] + 0.5 * slope[:, :3] * h[:, None]).T @ h) / STEP)
            believed.append(mean_wrench(fired, model, alone, a, b))
    return np.array(true), np.array(believed), np.array(shares), model


@pytest.mark.parametrize("droop", [0.0, 0.02, 0.6])
@pytest.mark.parametrize("change", [{}, SLOW], ids=["shipped", "slow"])
def test_the_droop_is_that_of_the_pulses_that_overlap(droop, change, vehicle):
    """Not of the mean number of open jets, which is another one wherever pulses begin or end."""
    vehicle = replace(
        vehicle, command_delay_s=0.0, valve=replace(vehicle.valve, **change),
        air=replace(vehicle.air, droop=droop), tolerance=replace(vehicle.tolerance, pulse=0.0),
    )  # fmt: skip
    true, believed, shares, model = flown(vehicle, 1, 40)
    np.testing.assert_allclose(believed, true, atol=1e-9)
    given = PERIOD * (shares[:, 1] @ model.effect.T).sum(axis=0)
    undrooped = PERIOD * (shares[:, 0] @ model.effect.T).sum(axis=0)
    whole = STEP * true.sum(axis=0)
    off, without = np.abs(given - whole).max(), np.abs(undrooped - whole).max()
    assert off < max(1e-6, 0.1 * without)
