"""Late, duplicated, reordered, expired and foreign messages are dropped and counted."""

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from testbed.core.lab import Impairment
from testbed.core.rows import PoseSamples, References
from testbed.core.types import (
    Accel,
    Demand,
    Health,
    Inputs,
    LawMessage,
    Pose,
    PoseSample,
    Reference,
    Trajectory,
    Twist,
)
from testbed.net.envelope import SCHEMA, START, Acceptance, Inbox, Outbox, head_of
from testbed.net.impairment import NetworkImpairment
from testbed.net.links import LocalMessages
from testbed.net.payload import body_of, open_setpoint


def demand(t):
    return Demand(t, 0.1, -0.2, 0.3, 0.0, 0.0, t + 0.2)


def inbox():
    return Inbox(open_setpoint, 7, 0.15)


def test_what_is_sent_is_what_arrives():
    out, box = Outbox(7), inbox()
    reference = Reference(1.0, Pose(1, 2, 3), Twist(4, 5, 6), Accel(7, 8, 9))
    for setpoint in (demand(1.0), Trajectory((reference, reference), 1.5)):
        assert box.take(out.seal(setpoint, 1.0, 1.3), 1.02) is Acceptance.TAKEN
        assert box.newest == setpoint
        assert box.valid_until == 1.3


def test_a_whole_tick_is_sent_and_read():
    """A vehicle on wires sends its ticks to the host, which logs them."""
    ahead = References.of((Reference(1.0, Pose(1, 2, 3), Twist(4, 5, 6), Accel(7, 8, 9)),))
    seen = PoseSamples.of((PoseSample(0.9, 1.0, 2.0, 3.0),))
    inputs = Inputs(1.0, True, seen, Trajectory(ahead, 1.5), {}, Health(1.0, 5e5, 2e7))
    assert msgspec.msgpack.decode(body_of(inputs), type=Inputs) == inputs


@pytest.mark.parametrize(
    ("arrived_at", "verdict"),
    [
        (1.0, Acceptance.TAKEN), (1.15, Acceptance.TAKEN), (1.1500001, Acceptance.LATE),
        (1.2000001, Acceptance.EXPIRED), (0.96, Acceptance.TAKEN), (0.9, Acceptance.GARBLED),
        (math.nan, Acceptance.EXPIRED),
    ],
)  # fmt: skip
def test_by_the_time_on_the_way(arrived_at, verdict):
    box = inbox()
    assert box.take(Outbox(7).seal(demand(1.0), 1.0, 1.2), arrived_at) is verdict
    assert box.counts[verdict] == 1
    assert (box.newest is None) == (verdict is not Acceptance.TAKEN)


def test_repeated_and_overtaken_messages_are_dropped():
    out, box = Outbox(7), inbox()
    first, second, third = (out.seal(demand(t), 1.0, 1.2) for t in (1.0, 1.1, 1.2))
    order = [second, second, first, third, first]
    assert [box.take(data, 1.01) for data in order] == [
        Acceptance.TAKEN, Acceptance.DUPLICATED, Acceptance.REORDERED, Acceptance.TAKEN,
        Acceptance.REORDERED,
    ]  # fmt: skip
    assert box.newest == demand(1.2)


def test_another_session_or_version_is_refused():
    box = inbox()
    assert box.take(Outbox(8).seal(demand(1.0), 1.0, 1.2), 1.0) is Acceptance.FOREIGN
    other = bytearray(Outbox(7).seal(demand(1.0), 1.0, 1.2))
    assert head_of(bytes(other)) == (7, 1, 1.0, 1.2, SCHEMA)
    other[4 + 32] += 1
    assert box.take(bytes(other), 1.0) is Acceptance.SCHEMA
    assert box.newest is None


def test_a_refused_message_does_not_use_up_its_number():
    box = inbox()
    out = Outbox(7)
    out.sent = 4
    nonsense = out.seal(demand(1.0), 1.0, 1.2)[:START] + b"nonsense"
    assert box.take(nonsense, 1.0) is Acceptance.GARBLED
    assert box.take(Outbox(7).seal(demand(1.0), 1.0, 1.2), 1.0) is Acceptance.TAKEN


@given(st.binary(max_size=300))
@settings(deadline=None)
def test_any_bytes_are_refused(data):
    box = inbox()
    assert box.take(data, 1.0) is not Acceptance.TAKEN
    assert box.newest is None


def test_flipped_bits_never_make_a_message_newer_than_it_is():
    rng = np.random.default_rng(2)
    whole = bytearray(Outbox(7).seal(demand(1.0), 1.0, 1.2))
    for _ in range(3000):
        data, box = bytearray(whole), inbox()
        data[rng.integers(len(data))] ^= 1 << rng.integers(8)
        box.take(bytes(data), 1.0)
        assert sum(box.counts.values()) == 1


def test_impairment_loses_and_delays_as_configured():
    impairment = NetworkImpairment(Impairment(loss=0.05, delay_s=0.020, spread_s=0.010), 1, "a")
    arrivals = [impairment.arrival(0) for _ in range(20_000)]
    kept = [1e-9 * t for t in arrivals if t is not None]
    assert len(kept) / len(arrivals) == pytest.approx(0.95, abs=0.005)
    assert min(kept) >= 0.010
    assert max(kept) <= 0.030
    assert np.mean(kept) == pytest.approx(0.020, abs=2e-4)


def test_no_impairment_does_nothing():
    impairment = NetworkImpairment(Impairment(), 1, "a")
    assert [impairment.arrival(t) for t in range(100)] == list(range(100))


def test_laws_on_one_computer_hear_each_other_a_tick_later():
    board = LocalMessages()
    board.tick = 1
    board.write("a", LawMessage(0.1, (1.0,)))
    assert board.read("b") == {}
    board.tick = 2
    board.write("a", LawMessage(0.2, (2.0,)))
    assert board.read("b") == {"a": LawMessage(0.1, (1.0,))}
    assert board.read("a") == {}
    board.tick = 3
    assert board.read("b") == {"a": LawMessage(0.2, (2.0,))}


def test_what_never_came_is_counted_and_how_long_the_newest_took():
    out, box = Outbox(7), Inbox(open_anything, 7, 1.0)
    messages = [out.seal(k, 0.1 * k, 10.0) for k in range(6)]
    for k in (0, 1, 4, 5):
        box.take(messages[k], 0.1 * k + 0.02)
    assert box.missed == 2
    assert box.delay == pytest.approx(0.02)
    assert box.issued_at == pytest.approx(0.5)


def open_anything(body):
    return msgspec.msgpack.decode(body)
