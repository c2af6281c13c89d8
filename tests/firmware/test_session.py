"""The sender's side against the firmware, over a line that loses frames."""

import msgspec
import numpy as np
import pytest

from firmware_interface.board import settled
from firmware_interface.frame import Frame, encode
from firmware_interface.inproc import InprocBoard
from firmware_interface.messages import VERSION, Ack, Fault, Result, State
from firmware_interface.session import CARRY_US, REFRESH_US, Session, SessionError, exchange
from testbed.core.types import ValveCommand


class Line:
    """Session and board with clocks apart, a delay each way, and a choice of what is lost."""

    def __init__(self, limits, delay_us=2_000, lost=lambda: False, clock_us=123_456_789):
        self.board = InprocBoard(limits, clock_us=clock_us)
        self.session = Session(limits, nonce=5)
        self.delay_us, self.lost = delay_us, lost
        self.now_us = 0
        self.under_way = []  # (arrives, to the board, bytes)
        self.edges = []

    def send(self, data):
        if data and not self.lost():
            self.under_way.append((self.now_us + self.delay_us, True, data))

    def until(self, t_us):
        while self.now_us < t_us:
            self.now_us += 1_000
            self.edges += self.board.run_until(self.now_us)
            for item in [i for i in self.under_way if i[0] <= self.now_us]:
                self.under_way.remove(item)
                if item[1]:
                    self.board.feed(item[2])
                else:
                    self.session.receive(item[2], self.now_us)
            if data := self.board.read():
                self.under_way.append((self.now_us + self.delay_us, False, data))
            self.send(self.session.due(self.now_us))

    def start(self):
        self.send(self.session.hello(self.now_us))
        self.until(self.now_us + 10_000)
        self.send(self.session.arm(self.now_us))
        self.until(self.now_us + 10_000)


def command(seq, t_us, on, until_us=300_000):
    t = t_us * 1e-6
    return ValveCommand(seq, t, t + until_us * 1e-6, (on,) + (0,) * 7, (0,) * 8)


def test_a_plan_is_flown_where_its_first_frame_put_it(limits):
    line = Line(limits)
    line.start()
    line.send(line.session.apply(command(1, line.now_us, 100_000), line.now_us))
    line.until(line.now_us + 200_000)
    assert line.session.state == State.ARMED
    assert line.edges == [(22_000, 1), (122_000, 0)]
    assert line.session.edges[0][0] - 123_456_789 == 22_000


def test_a_lost_frame_costs_one_refresh_period_at_the_front_only(limits):
    losses = iter([False, False, True] + [False] * 1000)  # hello, arm, plan, ...
    line = Line(limits, lost=lambda: next(losses))
    line.start()
    line.send(line.session.apply(command(1, line.now_us, 100_000), line.now_us))
    line.until(line.now_us + 200_000)
    assert line.edges == [(22_000 + REFRESH_US, 1), (122_000, 0)]


def test_a_fifth_of_all_frames_lost_trips_nothing(limits):
    rng = np.random.default_rng(3)
    line = Line(limits)
    line.start()
    line.lost = lambda: rng.random() < 0.2
    for seq in range(100):
        line.send(line.session.apply(command(seq, line.now_us, 50_000), line.now_us))
        line.until(line.now_us + 100_000)
    assert line.session.state == State.ARMED
    assert line.session.status.watchdog_trips == 0


def test_a_sender_that_goes_silent_trips_the_watchdog(limits):
    line = Line(limits)
    line.start()
    line.send(line.session.apply(command(1, line.now_us, 400_000), line.now_us))
    line.lost = lambda: True
    line.until(line.now_us + 300_000)
    assert line.session.status.faults == Fault.WATCHDOG
    assert line.edges == [(22_000, 1), (22_000 + limits.watchdog_us, 0)]


def test_a_plan_past_its_time_to_live_is_repeated_no_more(limits):
    session = Line(limits).session
    board = Line(limits)
    board.session = session
    board.start()
    session.apply(command(1, board.now_us, 50_000, until_us=50_000), board.now_us)
    assert session.due(board.now_us + REFRESH_US - 1) == b""
    assert session.due(board.now_us + REFRESH_US)
    assert session.due(board.now_us + 50_000) == b""  # though carried on: let the watchdog see it


# A pulse to the end of its plan

PERIOD = 100_000


class Unsteady(Line):
    """A line whose delay changes from frame to frame."""

    def __init__(self, limits, rng, most_us=4_000):
        super().__init__(limits)
        self.rng, self.most_us = rng, most_us

    def send(self, data):
        self.delay_us = 1_000 * self.rng.integers(1, self.most_us // 1_000 + 1)
        super().send(data)


def fly(line, wanted, period_us=PERIOD):
    """One plan per period, V0 open for `wanted` us of each; when the first left, and edges."""
    first = line.now_us
    for number, on_us in enumerate(wanted):
        # the time to live ends with the period, as the flight chain has it
        line.send(line.session.apply(command(number, line.now_us, on_us, period_us), line.now_us))
        line.until(line.now_us + period_us)
    line.until(line.now_us + period_us)
    return first, settled(line.edges)


@pytest.mark.parametrize("seed", range(5))
def test_a_continuous_demand_keeps_the_valve_open_though_plans_come_unsteadily(limits, seed):
    limits = msgspec.structs.replace(limits, max_on_us=5_000_000, duty_budget_us=3_000_000)
    line = Unsteady(limits, np.random.default_rng(seed))
    line.start()
    first, edges = fly(line, [PERIOD] * 20 + [0])
    (up, down) = edges
    assert first < up.t_us <= first + line.most_us
    assert first + 20 * PERIOD < down.t_us <= first + 20 * PERIOD + line.most_us


def test_a_lost_frame_does_not_interrupt_it_either(limits):
    limits = msgspec.structs.replace(limits, max_on_us=5_000_000, duty_budget_us=3_000_000)
    line = Line(limits)
    line.start()
    losses = iter([False] * 5 + [True] + [False] * 1000)  # the second plan's first frame
    line.lost = lambda: next(losses)
    _, edges = fly(line, [PERIOD, PERIOD, PERIOD, 0])
    assert [edge.mask for edge in edges] == [1, 0]
    assert edges[1].t_us - edges[0].t_us == 3 * PERIOD


def test_it_still_ends_at_the_maximum_on_time(limits):
    line = Unsteady(limits, np.random.default_rng(1))
    line.start()
    _, edges = fly(line, [PERIOD] * 5)
    assert edges[1].t_us - edges[0].t_us == limits.max_on_us
    assert edges[1].mask == 0


def test_a_sender_that_falls_silent_leaves_it_open_for_the_carry_only(limits):
    line = Line(limits)
    line.start()
    _, edges = fly(line, [PERIOD])
    assert edges == [(22_000, 1), (22_000 + PERIOD + CARRY_US, 0)]


def test_a_pulse_that_ends_before_its_plan_is_not_carried_on(limits):
    line = Line(limits)
    line.start()
    _, edges = fly(line, [PERIOD - 10_000])
    assert edges == [(22_000, 1), (22_000 + PERIOD - 10_000, 0)]


def test_the_carry_asks_for_nothing_that_the_board_refuses(limits):
    limits = msgspec.structs.replace(limits, max_ttl_us=PERIOD, max_on_us=PERIOD)
    line = Line(limits)
    line.start()
    _, edges = fly(line, [PERIOD])
    assert edges == [(22_000, 1), (22_000 + PERIOD, 0)]
    assert line.session.refusals == {}


def test_hello_is_repeated_until_answered(limits):
    losses = iter([True, True, False])
    line = Line(limits, lost=lambda: next(losses))
    line.send(line.session.hello(0))
    line.until(190_000)
    assert not line.session.greeted
    line.until(220_000)
    assert line.session.greeted


def test_of_several_sessions_the_newest_counts(limits):
    """On a slow line HELLO is repeated before its answer comes, and each one starts a session."""
    line = Line(limits, delay_us=60_000)
    line.send(line.session.hello(0))
    line.until(300_000)
    line.send(line.session.arm(line.now_us))
    line.until(line.now_us + 130_000)
    assert line.session.state == State.ARMED
    assert line.session.refusals == {}


def test_offset_and_delay_of_the_clock(limits):
    line = Line(limits, delay_us=3_000, clock_us=(1 << 32) - 5_000)  # wraps meanwhile
    line.start()
    clock = line.session.clock
    assert clock.offset_us == (1 << 32) - 5_000
    assert clock.delay_us == 6_000


def test_the_exchange_by_hand():
    assert exchange(1000, 5010, 5110, 1130) == (3995.0, 30)
    assert exchange((1 << 32) - 10, 100, 110, 20) == (100.0, 20)


def test_refusals_are_counted_by_name(limits):
    line = Line(limits)
    line.start()
    line.send(line.session.apply(command(1, line.now_us, 500_000), line.now_us))
    line.until(line.now_us + 10_000)
    assert line.session.refusals == {Result.ON_TOO_LONG: 1}


def test_a_board_built_for_another_vehicle_is_refused(limits):
    line = Line(limits)
    line.session = Session(msgspec.structs.replace(limits, min_on_us=1), 5)
    with pytest.raises(SessionError, match="build and flash the firmware for this vehicle"):
        line.start()


def test_a_board_of_another_protocol_is_refused(limits):
    with pytest.raises(
        SessionError, match=rf"speaks protocol {VERSION + 1}, this program {VERSION}"
    ):
        Session(limits, 5).receive(encode(Frame(Ack.CODE, 1, 0, b"", version=VERSION + 1)), 0)


def test_nothing_is_armed_before_hello_is_answered(limits):
    with pytest.raises(SessionError, match="has not answered HELLO"):
        Session(limits, 5).arm(0)
