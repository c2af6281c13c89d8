"""What becomes known of a flight on wires is given out once, whatever is asked for first."""

import pytest
from msgspec.structs import replace

from testbed.config import find, load
from testbed.core.law import Concern
from testbed.core.types import Health, Inputs, Outputs, Tick, ValveCommand, Vitals, Wrench
from testbed.core.warned import Warned
from testbed.flight.loop import Ending
from testbed.metrics.afterwards import After, Left
from testbed.net.commands import Counts, Ended, Pace, TickReport
from testbed.rig.observers import NullObserver
from testbed.rig.wired.run_results import RunResults

STILL = Wrench(0.0, 0.0, 0.0)
SHUT = (0,) * 8


def flown(k):
    t = 0.1 * k
    inputs = Inputs(t, True, (), None, {}, Health(t, 5e5, 2e7))
    outputs = Outputs(t, None, None, STILL, STILL, ValveCommand(k, t, t + 0.1, SHUT, SHUT))
    return TickReport(k, Tick(inputs, outputs), Pace(0.001 * k, None), ((t, 1), (t + 0.05, 0)))


@pytest.fixture
def findings():
    return RunResults(load(find("hold")))


def edges(findings):
    return [(name, valves.t, valves.mask) for name, valves in findings.valves(since=-1.0)]


@pytest.mark.parametrize("valves_first", [True, False])
def test_the_order_of_asking_does_not_matter(findings, valves_first):
    for k in (1, 2):
        findings.note_tick("sat1", flown(k))
    if valves_first:
        told = edges(findings)
        paces = list(findings.paces())
    else:
        paces = list(findings.paces())
        told = edges(findings)
    assert told == [
        ("sat1", t, mask) for t, mask in ((0.1, 1), (0.1 + 0.05, 0), (0.2, 1), (0.25, 0))
    ]
    assert [(name, t, pace.late_s) for name, t, pace in paces] == [
        ("sat1", 0.1, 0.001), ("sat1", 0.2, 0.002),
    ]  # fmt: skip


def test_nothing_is_given_out_twice(findings):
    findings.note_tick("sat1", flown(1))
    assert len(edges(findings)) == 2
    assert len(list(findings.paces())) == 1
    assert edges(findings) == []
    assert list(findings.paces()) == []
    findings.note_tick("sat1", flown(2))
    assert [mask for _, _, mask in edges(findings)] == [1, 0]


COUNTS = Counts({}, {}, {}, 0, 0, None, None)


def test_without_a_twin_the_vehicles_say_how_they_were_left(findings):
    over = Ending(3.0, None)
    assert findings.come_to_rest(over, NullObserver()) is None  # nobody has said anything
    findings.note_end("sat1", Ended(3.0, None, COUNTS, landed_s=0.4, air="off"))
    after = findings.come_to_rest(over, NullObserver())
    assert after == After(None, 0.4, "off", {"sat1": Left(0.4, "off")})


def test_what_comes_after_the_end_is_not_of_the_flight(findings):
    one = flown(1)
    findings.note_tick("sat1", one)
    before = findings.spent("sat1"), len(findings.track().t)
    inputs = replace(one.tick.inputs, vitals=Vitals(end=True))
    command = replace(one.tick.outputs.command, on_us=(50_000,) * 8)
    outputs = replace(one.tick.outputs, command=command)
    findings.note_tick("sat1", replace(one, tick=Tick(inputs, outputs)))
    assert (findings.spent("sat1"), len(findings.track().t)) == before


@pytest.mark.parametrize("is_over", [True, False], ids=["with a report", "without one"])
def test_rows_that_held_are_warnings_also_of_a_vehicle_that_died(findings, is_over):
    for k, rows in enumerate([(), ("pulled",), ("pulled", "link_late", "pose_lost"), ()]):
        one = flown(k)
        outputs = replace(one.tick.outputs, faults=rows)
        findings.note_tick("sat1", replace(one, tick=Tick(one.tick.inputs, outputs)))
    said = "pulled held; the vehicle's last report is missing"
    if is_over:
        said = "a hose"
        findings.note_end("sat1", Ended(3.0, None, COUNTS, warned={"pulled": Warned(0.1, 9, said)}))
    assert findings.concerns() == [Concern("pulled", f"sat1: {said} (from 0.1 s)")]


@pytest.mark.parametrize(("spoilt", "told"), [(1, False), (2, True)])
def test_the_operator_is_told_of_a_computer_that_is_busy(findings, spoilt, told):
    for k in range(100):
        one = flown(k)
        inputs = replace(one.tick.inputs, vitals=Vitals(late_s=0.03 if k < spoilt else 0.003))
        findings.note_tick("sat1", replace(one, tick=Tick(inputs, one.tick.outputs)))
    said = [concern.text for concern in findings.concerns() if concern.name == "late_plans"]
    assert len(said) == told
    assert all(text.startswith("sat1: 2 of 100 plans were sent late") for text in said)
