"""The time of flow is what comes out of the valves, not for how long they are commanded."""

import numpy as np
import pytest
from msgspec.structs import replace

from sim_twin.board import Board, no_pulses
from stages import Flow
from testbed.core.pulse import open_time, timing
from testbed.core.types import ValveCommand

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
        told += PERIOD * flow.of(command)
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
    assert flow.of(short)[0] == pytest.approx((0.030 - 0.025 + 0.015 - 0.001) / PERIOD)


def test_a_pulse_that_goes_on_loses_nothing_until_it_ends(vehicle):
    vehicle = replace(vehicle, valve=replace(vehicle.valve, **SLOW))
    flow, none = Flow(vehicle, PERIOD), (0,) * 7
    whole = ValveCommand(0, 0.0, PERIOD, (100_000, *none), (0, *none))
    shut = ValveCommand(1, PERIOD, 2 * PERIOD, (0, *none), (0, *none))
    assert [flow.of(whole)[0], flow.of(whole)[0]] == pytest.approx([1.0, 1.0])
    assert flow.of(shut)[0] == pytest.approx(-0.011 / PERIOD)
    assert flow.of(shut)[0] == 0.0
