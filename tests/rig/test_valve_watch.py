"""What the valves did is compared with what was planned, in the process that sends the plans."""

import pytest

from testbed.config import find, load
from testbed.core.types import ValveCommand
from testbed.flight.detectors import SPOILT
from testbed.rig.wired.valve_watch import COUNTS_AS, ValveWatch

PERIOD, DELAY = 0.1, 0.002
MS = 1e-3
SOON, LATER = 0.1, 0.2  # ticks: pulses in the middle of a plan are over at the first


def plan(k, on_ms, offset_ms=40):
    """Of two jets; the second one stays shut."""
    t = k * PERIOD
    return ValveCommand(k, t, t + PERIOD, (1000 * on_ms, 0), (1000 * offset_ms, 0))


def pulse(up_ms, down_ms):
    return [((up_ms + 2) * MS, 1), ((down_ms + 2) * MS, 0)]


@pytest.fixture
def watch():
    """That of a board which reports its edges."""
    watch = ValveWatch(2, DELAY, PERIOD)
    watch.receive([(-1.0, 2), (-0.9, 0)])
    assert watch.late_s(0.0) == 0.0
    return watch


@pytest.mark.parametrize("later", [0, 3, 30])
def test_a_pulse_of_the_planned_length_is_played_also_if_it_comes_later(watch, later):
    watch.plan(plan(0, 15))
    watch.receive(pulse(40 + later, 55 + later))
    assert watch.late_s(SOON) == watch.late_s(LATER) == 0.0


@pytest.mark.parametrize(
    "edges",
    [[], pulse(45, 55), pulse(40, 65), pulse(40, 55) + pulse(60, 70)],
    ids=["lost", "cut", "too long", "one more"],
)
def test_another_pulse_counts_as_a_late_tick_once(watch, edges):
    watch.plan(plan(0, 15))
    watch.receive(edges)
    assert watch.late_s(SOON) == pytest.approx(COUNTS_AS * PERIOD)
    assert watch.late_s(LATER) == 0.0


@pytest.mark.parametrize("longer", [-1, 1])
def test_a_difference_that_stamps_may_have_does_not_count(watch, longer):
    watch.plan(plan(0, 15))
    watch.receive(pulse(40, 55 + longer))
    assert watch.late_s(SOON) == 0.0


@pytest.mark.parametrize(
    "edges",
    [pulse(40, 55)[:1], pulse(40, 55) + pulse(70, 80)[:1]],
    ids=["from the pulse on", "after the pulse"],
)
def test_a_valve_that_stays_open_counts(watch, edges):
    watch.plan(plan(0, 15))
    watch.receive(edges)
    assert watch.late_s(SOON) > 0.0


def test_edges_may_be_reported_after_the_end_of_their_pulse(watch):
    watch.plan(plan(0, 15, 80))
    assert watch.late_s(SOON) == 0.0
    watch.receive(pulse(80, 95))
    assert watch.late_s(LATER) == 0.0


def test_a_plan_begins_after_the_delay_of_its_vehicle():
    watch = ValveWatch(2, 0.05, PERIOD)
    watch.receive([(-1.0, 2), (-0.9, 0)])
    watch.plan(plan(0, 15))
    assert watch.late_s(0.11) == 0.0  # the pulse has ended at 0.105 s
    assert watch.late_s(LATER) > 0.0


def test_a_jet_as_planned_does_not_excuse_another():
    watch = ValveWatch(2, DELAY, PERIOD)
    watch.receive([(-1.0, 0)])
    watch.plan(ValveCommand(0, 0.0, PERIOD, (15_000, 15_000), (40_000, 40_000)))
    watch.receive([(0.042, 2), (0.057, 0)])  # of the second jet only
    assert watch.late_s(SOON) > 0.0


def test_a_pulse_of_several_plans_is_one(watch):
    watch.plan(plan(0, 60, 40))
    assert watch.late_s(SOON) == 0.0  # it may go on
    watch.plan(plan(1, 100, 0))
    assert watch.late_s(LATER) == 0.0
    watch.plan(plan(2, 30, 0))
    watch.receive(pulse(40, 230))
    assert watch.late_s(3 * PERIOD) == watch.late_s(4 * PERIOD) == 0.0


def test_pulses_of_two_plans_with_a_pause_are_two(watch):
    watch.plan(plan(0, 15, 85))
    watch.plan(plan(1, 15, 5))
    watch.receive(pulse(85, 100) + pulse(105, 120))
    assert watch.late_s(LATER) == watch.late_s(3 * PERIOD) == 0.0


@pytest.mark.parametrize("second", [97, 104], ids=["stamped early", "played later"])
def test_of_pulses_close_to_each_other_each_has_its_plan(watch, second):
    watch.plan(plan(0, 15))
    watch.plan(plan(1, 25, 0))
    watch.receive(pulse(70, 85) + pulse(second, second + 25))
    assert watch.late_s(LATER) == 0.0


def test_each_pulse_is_compared_with_its_own_plan(watch):
    for k in range(5):
        watch.plan(plan(k, 12 + k))
        watch.receive(pulse(100 * k + 44, 100 * k + 56 + k))
        assert watch.late_s((k + 1) * PERIOD) == 0.0
    watch.plan(plan(5, 20))
    watch.plan(plan(6, 20))
    watch.receive(pulse(640, 660))  # the one before was lost
    assert watch.late_s(7 * PERIOD) > 0.0
    watch.plan(plan(7, 20))
    watch.receive(pulse(740, 760))
    assert watch.late_s(8 * PERIOD) == 0.0


def test_a_board_that_reports_no_edges_is_not_judged():
    watch = ValveWatch(2, DELAY, PERIOD)
    watch.plan(plan(0, 15))
    assert watch.late_s(SOON) == 0.0


def test_a_pulse_not_as_planned_counts_as_a_spoilt_tick_but_not_as_an_overrun():
    row = load(find("hold")).faults["overrun"]
    assert SPOILT < COUNTS_AS < row.above / PERIOD
