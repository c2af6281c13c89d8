"""Nothing but a plan of now goes out of the port, whatever is asked."""

import math

from hypothesis import given
from hypothesis import strategies as st

from testbed.core.codes import InhibitReason
from testbed.core.types import Health, ValveCommand
from testbed.rig.wired.command_guard import CommandGuard

PERIOD = 0.1


class Board:
    """Keeps what it gets."""

    def __init__(self):
        self.got, self.landed = [], 0

    def apply(self, command):
        self.got.append(command)

    def land(self):
        self.landed += 1

    def health(self):
        return Health(1.0, 5e5, 2e7)


def plan(seq, t, life=PERIOD, on=(50_000, 0)):
    return ValveCommand(seq, t, t + life, on, (0,) * len(on))


def at(now):
    return lambda: now


def test_plans_in_time_go_out():
    board = Board()
    gate = CommandGuard(board, at(2.0), PERIOD)
    for seq in (1, 2, 9):
        gate.apply(plan(seq, 1.95))
    assert [p.seq for p in board.got] == [1, 2, 9]
    assert (gate.refused, gate.reason) == (0, None)


def test_replayed_late_and_overlong_plans_do_not():
    board = Board()
    gate = CommandGuard(board, at(2.0), PERIOD)
    gate.apply(plan(5, 2.0))
    for bad in (plan(5, 2.0), plan(4, 2.0), plan(6, 1.8), plan(6, 2.0, life=1.0), plan(6, 2.5)):
        gate.apply(bad)
    assert gate.refused == 5
    assert gate.reason.code == InhibitReason.PLAN_FROM_FUTURE
    gate.apply(plan(6, 2.0))  # a refused one does not use its number up
    assert [p.seq for p in board.got] == [5, 6]


def test_the_rest_is_the_boards():
    board = Board()
    gate = CommandGuard(board, at(0.0), PERIOD)
    gate.land()
    assert board.landed == 1
    assert gate.health() == board.health()


times = st.floats(1.0, 3.0) | st.sampled_from([math.nan, math.inf, -math.inf, 2.0, 2.1])
counts = st.integers(-10, 200_000)
plans = st.builds(
    ValveCommand, st.integers(-3, 30), times, times,
    st.lists(counts, max_size=3).map(tuple), st.lists(counts, max_size=3).map(tuple),
)  # fmt: skip


@given(st.lists(st.tuples(plans, times), max_size=12))
def test_whatever_is_asked_what_goes_out_is_fresh_newer_and_short(asked):
    board, now = Board(), [0.0]
    gate = CommandGuard(board, lambda: now[0], PERIOD)
    newest = -1
    for command, t in asked:
        now[0] = t
        before = len(board.got)
        gate.apply(command)
        if len(board.got) > before:
            assert command.issued_at - 1.1e-3 <= t < command.valid_until
            assert command.valid_until - command.issued_at <= PERIOD + 1.1e-3
            assert command.seq > newest
            longest = 1e6 * PERIOD + 1_100
            assert all(
                on >= 0 and offset >= 0 and on + offset <= longest
                for on, offset in zip(command.on_us, command.offset_us, strict=True)
            )
            newest = command.seq
    assert len(board.got) + gate.refused == len(asked)
