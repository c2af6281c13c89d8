"""Sender, line and board together, in the run's time."""

import pytest

from firmware_interface.inproc import InprocBoard
from firmware_interface.messages import Result
from firmware_interface.session import CARRY_US, Session
from firmware_interface.wire import BAUD, Line, WiredBoard, WireError
from testbed.core.types import ValveCommand

PLAN_US = 2_040  # 94 bytes of ten bits at 460 800 baud, rounded up
PERIOD_US = 100_000


@pytest.fixture
def limits(host):
    return host.limits


@pytest.fixture
def wired(limits):
    return WiredBoard(InprocBoard(limits), limits)


def command(number, on_us, t_us=None, offset_us=()):
    t = (number * PERIOD_US if t_us is None else t_us) * 1e-6
    on = (*on_us, *(0,) * (8 - len(on_us)))
    offset = (*offset_us, *(0,) * (8 - len(offset_us)))
    return ValveCommand(number, t, t + PERIOD_US * 1e-6, on, offset)


# The line


def test_a_byte_takes_ten_bits_and_frames_queue():
    line = Line(100_000)
    line.send(1_000, b"12345")
    line.send(1_200, b"1")
    line.send(9_000, b"1")
    assert line.next_us == 1_500
    assert line.arrived(1_499) == []
    assert line.arrived(9_000) == [(1_500, b"12345"), (1_600, b"1")]
    assert line.next_us == 9_100


def test_nothing_takes_no_time():
    line = Line(BAUD)
    line.send(5, b"")
    assert line.next_us is None


# The board behind it


def test_a_plan_starts_when_its_last_bit_has_arrived(wired):
    wired.apply(command(0, (60_000, 20_000), offset_us=(0, 30_000)))
    assert wired.run_until(PERIOD_US) == [
        (PLAN_US, 1), (PLAN_US + 30_000, 3), (PLAN_US + 50_000, 1), (PLAN_US + 60_000, 0),
    ]  # fmt: skip


def test_a_slower_line_delays_it(limits):
    wired = WiredBoard(InprocBoard(limits), limits, baud=115_200)
    wired.apply(command(0, (60_000,)))
    assert wired.run_until(PERIOD_US)[0] == (8_160, 1)


def test_the_plan_is_repeated_at_50_hz_and_never_in_the_way_of_the_next(wired):
    for number in range(20):
        wired.apply(command(number, (60_000,)))
        edges = wired.run_until((number + 1) * PERIOD_US)
        assert [e.t_us - number * PERIOD_US for e in edges] == [PLAN_US, PLAN_US + 60_000]
    status = wired.session.status
    assert status.watchdog_trips == status.refused == status.lost_acks == 0
    assert wired.trouble is None


def test_silence_trips_the_board_and_is_named(wired):
    wired.apply(command(0, (60_000,)))
    wired.run_until(1_000_000)
    assert wired.trouble == "board in SAFE, faults WATCHDOG"


def test_a_refused_plan_is_named(wired):
    wired.apply(command(0, (50_000, 0, 0, 0, 0, 50_000)))  # opposing
    wired.run_until(PERIOD_US)
    assert wired.session.refusals.keys() == {Result.OPPOSING}
    assert "refused plans: OPPOSING" in wired.trouble


def test_a_board_that_does_not_answer_is_named(limits):
    board = InprocBoard(limits)
    board.lib.board_hold(board.handle, 1)
    with pytest.raises(WireError, match="answers HELLO"):
        WiredBoard(board, limits)


def test_a_board_that_cannot_be_armed_is_named(limits):
    with pytest.raises(WireError, match="cannot be armed"):
        WiredBoard(InprocBoard(limits, supply_mv=1_000), limits)


def test_a_board_that_hides_what_it_drives_is_found_out(wired):
    board, run_until = wired.board, wired.board.run_until
    board.run_until = lambda t_us: [*run_until(t_us), (t_us, 255)]
    with pytest.raises(WireError, match="drove"):
        wired.run_until(50_000)


# A valve that is open all the time


def late(wired, lateness_us):
    """Ten plans at 100 %, each late by as much as this says; the edges."""
    edges = []
    for number in range(3):
        t_us = number * PERIOD_US
        edges += wired.run_until(t_us + lateness_us(number))
        wired.apply(command(number, (PERIOD_US, 0, PERIOD_US), t_us=t_us + lateness_us(number)))
    return edges + wired.run_until(400_000)


@pytest.mark.parametrize("lateness_us", [0, 1, 2_500, CARRY_US])
def test_it_stays_open_from_plan_to_plan_also_when_plans_come_late(wired, lateness_us):
    edges = late(wired, lambda number: lateness_us * (number % 2))
    assert [edge.mask for edge in edges] == [5, 0]


def test_later_than_that_it_closes_for_its_minimum_off_time(wired, limits):
    edges = late(wired, lambda number: (CARRY_US + 1) * (number % 2))
    assert [edge.mask for edge in edges] == [5, 0, 5, 0]
    assert edges[2].t_us - edges[1].t_us == limits.min_off_us


def test_it_closes_at_once_when_the_next_plan_says_so(wired):
    wired.apply(command(0, (PERIOD_US,)))
    edges = list(wired.run_until(PERIOD_US))
    wired.apply(command(1, (0, 50_000)))
    edges += wired.run_until(2 * PERIOD_US)
    assert edges[:2] == [(PLAN_US, 1), (PLAN_US + PERIOD_US, 2)]


def test_a_pulse_that_ends_before_its_plan_is_not_carried_on(limits):
    session = Session(limits, 1)
    session._session = 1
    session.apply(command(0, (PERIOD_US - 1, PERIOD_US, 40_000), offset_us=(0, 0, 60_000)), 0)
    plan = session._plan
    assert plan.ttl_us == PERIOD_US + CARRY_US
    assert plan.on_us[:3] == (PERIOD_US - 1, PERIOD_US + CARRY_US, 40_000 + CARRY_US)


def test_nothing_is_carried_beyond_the_boards_limits(limits):
    session = Session(limits, 1, carry_us=10_000_000)
    session._session = 1
    session.apply(command(0, (PERIOD_US,)), 0)
    assert session._plan.ttl_us == limits.max_ttl_us
    assert session._plan.on_us[0] == limits.max_on_us
