"""Logged inputs through other code: the first tick that differs, and by how much."""

import math

import pytest

from testbed.core.types import (
    Health,
    HostInputs,
    HostOutputs,
    HostTick,
    Inputs,
    Outputs,
    Tick,
    ValveCommand,
    Wrench,
)
from testbed.logs.log_reader import LogError, Row
from testbed.logs.replay import LoggedHost, difference, replay
from testbed.logs.tick_row import RowWriter

CLOSED = ValveCommand(0, 0.0, 0.1, (0,) * 8, (0,) * 8)


def inputs(t: float) -> Inputs:
    return Inputs(t, True, (), None, {}, Health(t, 5e5, 2e7))


def outputs(t: float, fx: float) -> Outputs:
    force = Wrench(fx, 0.0, 0.0)
    return Outputs(t, None, None, force, force, CLOSED, None, None)


def flight(fx: float = 0.1, ticks: int = 10) -> list[Row]:
    rows = []
    for k in range(ticks):
        tick = Tick(inputs(0.1 * k), outputs(0.1 * k, fx))
        rows.append(Row("/sat1/tick", k * 10**8, row_of("/sat1/tick", tick)))
    return rows


def row_of(topic: str, tick: Tick | HostTick) -> bytes:
    return RowWriter().rows(topic, tick.inputs.t, tick)[-1].data


def same(told: Inputs) -> Outputs:
    return outputs(told.t, 0.1)


def test_the_same_code_gives_no_difference():
    verdict = replay(flight(), {"sat1": same}, {})
    assert (verdict.ticks, verdict.first_difference) == (10, None)


def test_the_first_difference_and_its_size():
    def later(told: Inputs) -> Outputs:
        return outputs(told.t, 0.1 if told.t < 0.45 else 0.125)

    first = replay(flight(), {"sat1": later}, {}).first_difference
    assert (first.tick, first.topic, first.field) == (5, "/sat1/tick", "commanded_wrench.fx")
    assert (first.logged, first.now) == (0.1, 0.125)
    assert first.size == pytest.approx(0.025)


def test_one_bit_is_a_difference():
    def nearly(told: Inputs) -> Outputs:
        return outputs(told.t, math.nextafter(0.1, 1.0))

    assert replay(flight(), {"sat1": nearly}, {}).first_difference.size == math.ulp(0.1)


def test_a_law_on_the_host_hears_what_was_heard_then():
    told = HostInputs(0.3, None, {})
    row = Row("/sat1/host", 0, row_of("/sat1/host", HostTick(told, HostOutputs(0.3, None))))

    def plug(link):
        def tick(t: float) -> HostTick:
            assert (link.own(), link.neighbours(), link.messages()) == (None, {}, {})
            return HostTick(told, HostOutputs(t, None))

        return tick

    assert replay([row], {}, {"sat1": LoggedHost(plug)}).first_difference is None


def test_other_topics_do_not_matter():
    assert replay([Row("/truth", 0, b"{}"), *flight()], {"sat1": same}, {}).ticks == 10


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([], "no ticks"),
        ([Row("/sat2/tick", 0, flight()[0].data)], "/sat2/tick is in the log"),
        ([Row("/sat1/tick", 0, b"{}")], "expected  a message of this version"),
    ],
)
def test_a_log_that_cannot_be_repeated(rows, said):
    with pytest.raises(LogError, match=said):
        replay(rows, {"sat1": same}, {})


@pytest.mark.parametrize(
    ("then", "now", "found"),
    [
        ({"a": 1}, {"a": 1}, None),
        ({"a": [1, 2]}, {"a": [1, 3]}, ("a[1]", 2, 3, 1)),
        ({"a": [1]}, {"a": [1, 3]}, ("a[1]", None, 3, None)),
        ({"a": None}, {"a": {"b": 1}}, ("a", None, {"b": 1}, None)),
        ({}, {"a": "x"}, ("a", None, "x", None)),
        ({"a": math.nan}, {"a": math.nan}, None),
        ({"a": 0.0}, {"a": -0.0}, ("a", 0.0, -0.0, 0.0)),
        ({"a": True}, {"a": False}, ("a", True, False, None)),
    ],
)
def test_differences(then, now, found):
    assert difference(then, now) == found
