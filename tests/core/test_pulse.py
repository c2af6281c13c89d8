"""A pulse behind a solenoid, against the flow as a function of time, integrated numerically."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.integrate import quad

from testbed.core.pulse import Timing, corners, open_time, timing

SHIPPED = Timing(0.006, 0.006, 0.002, 0.002)
SLOW = Timing(0.012, 0.020, 0.010, 0.015)

delays = st.floats(0.0, 0.03)
ramps = st.one_of(st.just(0.0), st.floats(1e-4, 0.02))
valves = st.builds(Timing, delays, delays, ramps, ramps)
widths = st.floats(0.0, 0.2)


def flow(t, up, down, valve):
    """Flow at `t`: the plug opens at its own speed until the closing begins, then falls."""

    def opened(s):
        if s < up + valve.open_delay:
            return 0.0
        if valve.open_ramp == 0.0:
            return 1.0
        return min(1.0, (s - up - valve.open_delay) / valve.open_ramp)

    fall = down + valve.close_delay
    if t < fall:
        return opened(t)
    if fall <= up + valve.open_delay:
        return 0.0
    if valve.close_ramp == 0.0:
        return 0.0
    return max(0.0, opened(fall) - (t - fall) / valve.close_ramp)


def integrated(up, down, valve, start, end):
    cuts = [c for c in corners(up, down, valve)[:4] if start < c < end]
    total, edges = 0.0, [start, *sorted(set(cuts)), end]
    for a, b in pairwise(edges):
        total += quad(flow, a, b, args=(up, down, valve), epsabs=1e-13)[0]
    return total


@given(widths, valves, st.floats(-0.1, 0.3), st.floats(0.0, 0.4))
def test_open_time_is_the_integral_of_the_flow(width, valve, start, span):
    up = 0.05
    expected = integrated(up, up + width, valve, start, start + span)
    assert open_time(up, up + width, valve, start, start + span) == pytest.approx(
        expected, abs=1e-9
    )


@given(widths, valves, st.lists(st.floats(-0.2, 0.5), min_size=2, max_size=6))
def test_open_time_adds_up_over_intervals(width, valve, cuts):
    cuts = sorted(cuts)
    parts = [open_time(0.0, width, valve, a, b) for a, b in pairwise(cuts)]
    assert sum(parts) == pytest.approx(open_time(0.0, width, valve, cuts[0], cuts[-1]), abs=1e-15)


@given(widths, valves)
def test_open_time_of_a_full_pulse_has_a_closed_form(width, valve):
    full = width + valve.close_delay - valve.open_delay  # from the start of rise to that of fall
    assume(full >= valve.open_ramp)
    expected = full - 0.5 * valve.open_ramp + 0.5 * valve.close_ramp
    assert open_time(0.0, width, valve, -1.0, 2.0) == pytest.approx(expected, abs=1e-14)


@given(widths, valves)
def test_corners_are_in_order(width, valve):
    rise, top, fall, shut, peak = corners(0.0, width, valve)
    assert rise <= top <= fall <= shut
    assert 0.0 <= peak <= 1.0


@given(widths, valves, st.floats(-10.0, 10.0), st.floats(-0.1, 0.1), st.floats(0.0, 0.3))
def test_open_time_moves_with_the_command(width, valve, later, start, span):
    now = open_time(0.0, width, valve, start, start + span)
    then = open_time(later, later + width, valve, later + start, later + start + span)
    assert then == pytest.approx(now, abs=1e-9)


def test_corners_of_a_trapezoid():
    assert corners(1.0, 1.02, SHIPPED) == pytest.approx((1.006, 1.008, 1.026, 1.028, 1.0))


def test_a_pulse_that_closes_while_it_opens_is_a_triangle():
    # 12 ms of opening delay and 20 ms of closing delay: a 1 ms pulse flows for 9 ms of 10 ms ramp
    expected = (1.012, 1.021, 1.021, 1.021 + 0.9 * 0.015, 0.9)
    assert corners(1.0, 1.001, SLOW) == pytest.approx(expected)
    area = 0.5 * 0.9 * (0.009 + 0.9 * 0.015)
    assert open_time(1.0, 1.001, SLOW, 0.0, 2.0) == pytest.approx(area, abs=1e-15)


@pytest.mark.parametrize("width", [0.0, 1e-6, 0.003, 0.00799])
def test_a_pulse_that_closes_before_it_flows_is_swallowed(width):
    slow_to_open = Timing(0.010, 0.002, 0.001, 0.001)
    assert corners(0.0, width, slow_to_open)[4] == 0.0
    assert open_time(0.0, width, slow_to_open, -1.0, 1.0) == 0.0


@given(widths, valves, st.floats(0.0, 0.05))
def test_a_longer_pulse_never_flows_less(width, valve, more):
    shorter = open_time(0.0, width, valve, -1.0, 2.0)
    assert open_time(0.0, width + more, valve, -1.0, 2.0) >= shorter - 1e-15


def test_a_valve_without_ramps_flows_for_the_commanded_time():
    sharp = Timing(0.006, 0.006, 0.0, 0.0)
    assert open_time(0.0, 0.03, sharp, -1.0, 1.0) == pytest.approx(0.03, abs=1e-16)
    assert open_time(0.0, 0.03, sharp, 0.0, 0.01) == pytest.approx(0.004, abs=1e-16)


def test_an_interval_away_from_the_pulse_sees_nothing():
    assert open_time(0.0, 0.05, SHIPPED, -1.0, 0.006) == 0.0
    assert open_time(0.0, 0.05, SHIPPED, 0.058, 1.0) == 0.0


def test_timing_is_the_valve_of_the_vehicle_file(shipped_vehicle):
    assert timing(shipped_vehicle.valve) == SHIPPED


def test_compiled_and_plain_agree():
    rng = np.random.default_rng(3)
    for up, width, start, span in rng.uniform(0.0, 0.1, (200, 4)):
        bounds = (up, up + width, SLOW, start, start + span)
        assert open_time(*bounds) == pytest.approx(open_time.py_func(*bounds), abs=1e-17)
