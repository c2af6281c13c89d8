"""What the board does with a plan, to the nanosecond."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_twin.board import Board, nanoseconds, no_pulses
from sim_twin.flow import pieces
from testbed.core.pulse import open_time, timing

JETS = 8
JET = 5
DELAY, MIN_ON, MIN_OFF = 2, 10, 10  # of the shipped vehicle [ms]
AT_ONCE = {"open_delay_s": 0.0, "close_delay_s": 0.0, "open_ramp_s": 0.0, "close_ramp_s": 0.0}


def board_of(vehicle):
    return Board(vehicle, no_pulses(JETS), np.random.default_rng(0))


def delivered(board, vehicle, start, end):
    """Seconds of full flow of `JET` in [start, end], start in whole ns."""
    effect, thrust = np.zeros((3, JETS)), np.zeros(JETS)
    thrust[JET] = 1.0
    cuts, value, slope = pieces(
        board.pulses, np.array(timing(vehicle.valve)), effect, thrust, 0.0, np.zeros(JETS),
        nanoseconds(start), end - start,
    )  # fmt: skip
    h = np.diff(cuts)
    return float((value[:, 3] * h + 0.5 * slope[:, 3] * h**2).sum())


def closed_form(board, vehicle, start, end):
    """The same from the board's pulses, one by one."""
    commands = zip(board.pulses.up[JET], board.pulses.down[JET], strict=True)
    valve = timing(vehicle.valve)
    return sum(open_time(up * 1e-9, down * 1e-9, valve, start, end) for up, down in commands)


def opened_for(on, valve):
    """Seconds of full flow that an on-time commanded alone gives."""
    flowing = on + valve.close_delay_s - valve.open_delay_s  # before it starts to fall
    if on == 0.0 or on < valve.min_on_s or flowing <= 0.0:
        return 0.0
    if flowing >= valve.open_ramp_s:
        return flowing + 0.5 * (valve.close_ramp_s - valve.open_ramp_s)
    peak = flowing / valve.open_ramp_s
    return 0.5 * peak * (flowing + peak * valve.close_ramp_s)


us = st.integers(0, 40_000).map(lambda n: n * 1e-6)
valves = st.fixed_dictionaries(
    dict.fromkeys(
        ("open_delay_s", "close_delay_s", "open_ramp_s", "close_ramp_s", "min_on_s", "min_off_s"),
        us,
    )
)


@settings(deadline=None, max_examples=300)
@given(valves, us, st.integers(0, 100_000), st.integers(0, 100_000), st.integers(0, 10**7))
def test_one_pulse_delivers_what_the_valve_makes_of_it(
    make_vehicle, make_plan, valve, delay, on, offset, issued
):
    vehicle = make_vehicle(valve=valve, command_delay_s=delay)
    board, t = board_of(vehicle), issued * 1e-6
    board.apply(make_plan(t, {JET: (offset * 1e-6, on * 1e-6)}, lifetime=0.2))
    wanted = opened_for(on * 1e-6, vehicle.valve)
    assert delivered(board, vehicle, t, t + 0.4) == pytest.approx(wanted, abs=1e-9)
    assert closed_form(board, vehicle, t, t + 0.4) == pytest.approx(wanted, abs=1e-9)
    # nothing comes early, nothing late
    first = t + delay + offset * 1e-6 + valve["open_delay_s"]
    last = first - valve["open_delay_s"] + on * 1e-6 + valve["close_delay_s"]
    assert delivered(board, vehicle, t, first) == pytest.approx(0.0, abs=1e-9)
    late = last + valve["close_ramp_s"]
    assert delivered(board, vehicle, late, t + 0.4) == pytest.approx(0.0, abs=1e-9)


class Plan(NamedTuple):
    """A plan for `JET`, all in ms."""

    issued: int
    lifetime: int
    offset: int
    on: int


def open_ticks(plans, horizon):
    """The rules once more, as a machine that ticks every millisecond: open or not in each."""
    is_open, closed_at, ticks = False, -(10**6), []
    for now in range(horizon):
        begun = [plan for plan in plans if plan.issued + DELAY <= now]
        wanted, left = False, 0
        if begun:
            plan = begun[-1]
            start = plan.issued + DELAY
            up, down = start + plan.offset, start + min(plan.offset + plan.on, plan.lifetime)
            wanted, left = up <= now < down, down - now
        if is_open and not wanted:
            is_open, closed_at = False, now
        elif wanted and not is_open:
            rested = now - closed_at >= MIN_OFF
            is_open = rested and plan.on >= MIN_ON and left >= MIN_ON
        ticks.append(is_open)
    return ticks


@st.composite
def flights(draw):
    plans, now = [], 0
    for _ in range(draw(st.integers(1, 8))):
        # often exactly one period, so that pulses may join
        now += draw(st.sampled_from((40, 40, 100)) | st.integers(1, 60))
        joined = draw(st.booleans())
        offset = 0 if joined else draw(st.integers(0, 45))
        on = draw(st.sampled_from((0, 40, 100)) | st.integers(0, 60))
        plans.append(Plan(now, draw(st.sampled_from((40, 100)) | st.integers(0, 60)), offset, on))
    return plans


@settings(deadline=None, max_examples=500)
@given(flights())
def test_plans_in_a_row_follow_the_rules(make_vehicle, make_plan, plans):
    vehicle = make_vehicle(valve=AT_ONCE)
    board = board_of(vehicle)
    horizon = plans[-1].issued + DELAY + 200
    ticks = open_ticks(plans, horizon)
    starts = [plan.issued + DELAY for plan in plans]
    for plan, (start, end) in zip(plans, pairwise([*starts, horizon]), strict=True):
        pulses = {JET: (plan.offset * 1e-3, plan.on * 1e-3)}
        board.apply(make_plan(plan.issued * 1e-3, pulses, lifetime=plan.lifetime * 1e-3))
        wanted = pytest.approx(sum(ticks[start:end]) * 1e-3, abs=1e-9)
        assert delivered(board, vehicle, start * 1e-3, end * 1e-3) == wanted
        assert closed_form(board, vehicle, start * 1e-3, end * 1e-3) == wanted
    assert board.openings == sum(now and not before for before, now in pairwise([False, *ticks]))


# The rules one by one; (up, down) in ms of all that the board opened


@pytest.fixture(scope="module")
def openings(make_vehicle, make_plan):
    vehicle = make_vehicle()
    assert (vehicle.command_delay_s, vehicle.valve.min_on_s, vehicle.valve.min_off_s) == (
        DELAY * 1e-3, MIN_ON * 1e-3, MIN_OFF * 1e-3,
    )  # fmt: skip

    def run(*plans):
        board = board_of(vehicle)
        for plan in plans:
            pulses = {JET: (plan.offset * 1e-3, plan.on * 1e-3)}
            board.apply(make_plan(plan.issued * 1e-3, pulses, lifetime=plan.lifetime * 1e-3))
        opened = board.pulses.up[JET] >= 0
        pairs = np.stack([board.pulses.up[JET], board.pulses.down[JET]], axis=1)[opened]
        assert (np.delete(board.pulses.up, JET, axis=0) < 0).all()
        return [(up / 1e6 - DELAY, down / 1e6 - DELAY) for up, down in pairs.tolist()]

    return run


def test_a_plan_is_played_after_the_delay(openings):
    assert openings(Plan(0, 100, 20, 50)) == [(20, 70)]


def test_a_pulse_below_the_minimum_is_swallowed(openings):
    assert openings(Plan(0, 100, 20, 9)) == []
    assert openings(Plan(0, 100, 20, 10)) == [(20, 30)]


def test_a_shortest_pulse_that_is_no_whole_microsecond_is_played(make_vehicle, make_plan):
    """Plans are in whole microseconds, and the firmware rounds its limits to them, too."""
    board = board_of(make_vehicle(valve={"min_on_s": 0.0255372}))
    board.apply(make_plan(0.0, {JET: (0.02, 0.025536)}))
    assert (board.pulses.up < 0).all()
    board.apply(make_plan(0.1, {JET: (0.02, 0.025537)}))
    assert (board.pulses.up[JET] >= 0).sum() == 1


def test_an_opening_waits_for_the_minimum_off_time(openings):
    before = Plan(0, 100, 40, 57)  # closes 3 ms before the next plan
    assert openings(before, Plan(100, 100, 0, 60)) == [(40, 97), (107, 160)]
    assert openings(before, Plan(100, 100, 7, 60)) == [(40, 97), (107, 167)]


def test_what_is_left_after_the_wait_may_be_too_short(openings):
    before = Plan(0, 100, 40, 57)
    assert openings(before, Plan(100, 100, 0, 17)) == [(40, 97), (107, 117)]
    assert openings(before, Plan(100, 100, 0, 16)) == [(40, 97)]


def test_pulses_without_a_gap_are_one_opening(openings):
    full = [Plan(100 * k, 100, 0, 100) for k in range(6)]
    assert openings(*full) == [(0, 600)]
    assert openings(*full, Plan(600, 100, 0, 5)) == [(0, 605)]


@pytest.mark.parametrize("period", [1 / 30, 1 / 60, 0.14285714])
def test_whole_periods_of_no_whole_microseconds_are_one_opening(make_vehicle, make_plan, period):
    board = board_of(make_vehicle())
    for k in range(6):
        board.apply(make_plan(k * period, {JET: (0.0, period)}, lifetime=period))
    assert board.openings == 1
    lasted = 1e-9 * float(board.pulses.down[JET, -1] - board.pulses.up[JET, -1])
    assert lasted == pytest.approx(6 * period, abs=1e-6)


def test_a_new_plan_cuts_the_old_one_at_once(openings):
    assert openings(Plan(0, 100, 0, 100), Plan(30, 100, 50, 20)) == [(0, 30), (80, 100)]
    assert openings(Plan(0, 100, 0, 100), Plan(3, 100, 0, 0)) == [(0, 3)]


def test_a_new_plan_cancels_what_has_not_begun(openings):
    assert openings(Plan(0, 100, 50, 20), Plan(30, 100, 10, 30)) == [(40, 70)]
    assert openings(Plan(0, 100, 50, 20), Plan(30, 100, 0, 0)) == []


def test_nothing_is_open_after_the_time_to_live(openings):
    assert openings(Plan(0, 60, 20, 80)) == [(20, 60)]
    assert openings(Plan(0, 29, 20, 80)) == []
    assert openings(Plan(0, 100, 0, 100), Plan(100, 30, 0, 100)) == [(0, 130)]


def test_a_plan_that_came_too_late_closes_the_valves(openings):
    assert openings(Plan(0, 100, 0, 100), Plan(40, -5, 0, 100)) == [(0, 40)]


def test_a_cancelled_pulse_leaves_the_others_as_they_were(openings):
    played = [Plan(30 * k, 30, 0, 15) for k in range(4)]
    cancelled = [Plan(120, 100, 20, 15), Plan(125, 100, 0, 0)]
    assert openings(*played, *cancelled) == [(30, 45), (60, 75), (90, 105)]


@settings(deadline=None, max_examples=100)
@given(st.lists(st.tuples(st.integers(0, 300), st.integers(0, 100)), max_size=6))
def test_a_command_of_zero_opens_nothing(make_vehicle, make_plan, plans):
    vehicle = make_vehicle()
    board = board_of(vehicle)
    for issued, offset in sorted(plans):
        board.apply(make_plan(issued * 1e-3, {JET: (offset * 1e-3, 0.0)}))
    assert board.openings == 0
    assert delivered(board, vehicle, 0.0, 1.0) == 0.0


def test_pulses_differ_by_the_tolerance(make_vehicle, make_plan):
    vehicle = make_vehicle(tolerance={"pulse": 0.005})
    board, strengths = board_of(vehicle), []
    for k in range(2000):
        board.apply(make_plan(0.1 * k, {JET: (0.02, 0.05)}))
        strengths.append(board.pulses.strength[JET, -1])
    assert np.mean(strengths) == pytest.approx(1.0, abs=0.0005)
    assert np.std(strengths) == pytest.approx(0.005, rel=0.06)
