"""Cutting the flow into linear pieces loses nothing, wherever it is cut."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from sim_twin.board import SLOTS, no_pulses
from sim_twin.flow import pieces
from testbed.core.pulse import Timing, open_time

JETS = 3
NS = 1e-9


class Cut(NamedTuple):
    """What `pieces` returns."""

    start: np.ndarray
    value: np.ndarray
    slope: np.ndarray

    @property
    def length(self):
        return np.diff(self.start)

    @property
    def end_value(self):
        return self.value + self.slope * self.length[:, None]

    @property
    def integral(self):
        return (0.5 * (self.value + self.end_value) * self.length[:, None]).sum(axis=0)


def cut(pulses, timing, *, droop=0.0, late=(0.0, 0.0, 0.0), origin=0, span=0.2):
    """Each of three jets has an axis of the wrench for itself; all have one newton."""
    effect, thrust = np.eye(JETS), np.ones(JETS)
    return Cut(
        *pieces(pulses, np.array(timing), effect, thrust, droop, np.array(late), origin, span)
    )


def filled(commands, strength=1.0):
    """Pulses of each jet from (up, down) in ns, newest last."""
    pulses = no_pulses(JETS)
    pulses.strength[:] = strength
    for jet, pairs in enumerate(commands):
        for slot, (up, down) in enumerate(pairs, SLOTS - len(pairs)):
            pulses.up[jet, slot], pulses.down[jet, slot] = up, down
    return pulses


ms = st.integers(0, 40_000).map(lambda us: us * 1e-6)
ramp = st.integers(1, 40_000).map(lambda us: us * 1e-6)
timings = st.builds(Timing, ms, ms, ms, ms)
sloping = st.builds(Timing, ms, ms, ramp, ramp)
instants = st.integers(-100_000_000, 300_000_000)  # [ns]
trains = st.lists(instants, min_size=0, max_size=2 * SLOTS, unique=True).map(
    lambda times: list(zip(*[iter(sorted(times))] * 2, strict=False))
)
commands = st.tuples(trains, trains, trains)


@settings(deadline=None, max_examples=300)
@given(commands, timings)
def test_pieces_add_up_to_the_closed_form(commands, timing):
    integral = cut(filled(commands), timing).integral
    wanted = [
        sum(open_time(up * NS, down * NS, timing, 0.0, 0.2) for up, down in pairs)
        for pairs in commands
    ]
    assert_allclose(integral, [*wanted, sum(wanted)], atol=1e-14)


@settings(deadline=None, max_examples=300)
@given(commands, timings, st.integers(1, 199_999_999))
def test_two_windows_hold_what_one_holds(commands, timing, middle):
    pulses = filled(commands)
    first = cut(pulses, timing, span=middle * NS)
    second = cut(pulses, timing, origin=middle, span=(200_000_000 - middle) * NS)
    assert_allclose(first.integral + second.integral, cut(pulses, timing).integral, atol=1e-14)


@settings(deadline=None, max_examples=300)
@given(commands, timings, st.floats(0.0, 0.2))
def test_flow_is_never_negative(commands, timing, droop):
    flow = cut(filled(commands), timing, droop=droop)
    assert flow.start[0] == 0.0
    assert flow.start[-1] == 0.2
    assert flow.length.min() > 0.0
    assert flow.value.min() > -1e-9
    assert flow.end_value.min() > -1e-9


@settings(deadline=None, max_examples=300)
@given(commands, sloping)
def test_flow_is_continuous(commands, timing):
    flow = cut(filled(commands), timing)
    # 1e-17 s of rounding in a corner against the steepest ramp, a microsecond
    assert_allclose(flow.value[1:], flow.end_value[:-1], atol=1e-9)


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_open_jets_share_the_supply(count):
    """Thrust of each of n open jets is thrust / (1 + k (n - 1))."""
    together = filled([[(-50_000_000, 300_000_000)]] * count)
    flow = cut(together, Timing(0.006, 0.006, 0.002, 0.002), droop=0.05)
    each = 1.0 / (1.0 + 0.05 * (count - 1)) if count else 0.0
    assert_allclose(flow.value[:, :3], [[each] * count + [0.0] * (3 - count)])
    assert_allclose(flow.value[:, 3], count * each)


def test_a_jet_that_opens_again_while_it_closes_is_one_open_jet():
    timing = Timing(0.001, 0.020, 0.010, 0.010)
    pulses = filled([[(0, 50_000_000), (60_000_000, 100_000_000)]])
    alone, shared = cut(pulses, timing), cut(pulses, timing, droop=0.05)
    assert_allclose(shared.integral, alone.integral)


def test_strength_scales_a_pulse():
    pulses = filled([[(0, 50_000_000)], [(0, 80_000_000)]])
    pulses.strength[1, -1] = 0.9
    timing = Timing(0.006, 0.008, 0.002, 0.004)
    assert_allclose(cut(pulses, timing).integral[:3], [0.053, 0.9 * 0.083, 0.0])
