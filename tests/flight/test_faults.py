"""The fault table: every row is walked, and the watch does with it what it says."""

import math

import msgspec
import pytest
from msgspec.structs import replace

from stages import QUIET, FaultMonitor, Safety
from testbed.config import find, load
from testbed.config.shipped import shipped_faults
from testbed.core.codes import Detector, FaultCause, FaultReport, Response
from testbed.core.types import Health, Inputs, Vitals, Wrench
from testbed.flight.faults import Fault, FaultTable
from testbed.rig.forked import make_vehicle

TABLE = shipped_faults()
DETECTORS = [one.words for one in Detector]
WELL = {  # what every detector says when all is well
    **dict.fromkeys(DETECTORS, 0.0),
    "pose_age": 0.03,
    "supply_share": 1.0,
    "tank_loss": 0.0,
    "battery": 12.0,
    "spare_room": math.inf,
    "disk_free": 1e12,
    "setpoint_age": 0.0,
    "setpoint_overdue": -0.5,
    "pose_rate": 1.0,
}
NEEDED = {  # what the issue of a table of faults asks for, and the detector that sees it
    "pose_age", "pose_repeats", "pose_jump", "pose_of_another", "setpoint_age", "setpoint_overdue",
    "poses_rejected", "supply_share", "battery", "jet_open", "jet_leaks", "jet_leaks_or_weak",
    "jet_missing", "tank_loss", "spare_room", "law_error", "not_a_number", "tick_late",
    "operator_age", "clock_offset", "config_differs", "disk_free", "neighbour_age", "board_silent",
    "fleet", "foreign", "jet_partly_weak", "pull", "pull_share", "pad_drag", "thrust_or_mass",
    "heading_off", "poses_late", "late_step", "frame_step", "heading_step", "pose_rate",
    "bumped", "nudged",
}  # fmt: skip
PERIOD = 0.1  # [s]


def numbers(**changes):
    return tuple((WELL | changes)[name] for name in DETECTORS)


def bad(row, by=1e-6):
    """A number just beyond a row's bound."""
    return row.above + by if row.above is not None else row.below - by


def good(row):
    """The bound itself, which is not beyond it."""
    return row.above if row.above is not None else row.below


def run(watch, row, value, ticks, armed=True, t=0.0):
    verdict = None
    for k in range(ticks):
        now = numbers(**{row.detector: value})
        verdict = watch.look(t + k * PERIOD, armed, now, "somebody")
    return verdict


def ticks_of(row):
    """Ticks until a row holds."""
    return max(row.misses, math.ceil(row.timeout_s / PERIOD - 1e-9) + 1)


def test_every_detector_has_a_row_and_every_row_is_well_when_all_is():
    assert {row.detector for row in TABLE.values()} == set(DETECTORS) == NEEDED
    verdict = FaultMonitor(TABLE).look(0.0, True, numbers())
    assert verdict == QUIET


@pytest.mark.parametrize("name", TABLE)
def test_a_row_holds_after_its_misses_and_its_time_and_not_before(name):
    row, watch = TABLE[name], FaultMonitor({name: TABLE[name]})
    assert run(watch, row, bad(row), ticks_of(row) - 1) in (None, QUIET)
    verdict = run(watch, row, bad(row), 1, t=(ticks_of(row) - 1) * PERIOD)
    assert verdict.response == row.code
    assert verdict.holding == (name,)
    assert (verdict.fault is not None) == row.latched


@pytest.mark.parametrize("name", TABLE)
def test_a_row_does_not_hold_at_its_bound(name):
    row = TABLE[name]
    watch = FaultMonitor({name: row})
    assert run(watch, row, good(row), 50) == QUIET


@pytest.mark.parametrize("name", TABLE)
def test_a_number_that_is_none_is_beyond_every_bound(name):
    row = TABLE[name]
    verdict = run(FaultMonitor({name: row}), row, math.nan, ticks_of(row))
    assert verdict.response == row.code


@pytest.mark.parametrize("name", TABLE)
def test_one_good_tick_begins_the_count_again(name):
    row, watch = TABLE[name], FaultMonitor({name: TABLE[name]})
    before = ticks_of(row) - 1
    run(watch, row, bad(row), before)
    run(watch, row, good(row), 1, t=before * PERIOD)
    verdict = run(watch, row, bad(row), max(before, 0), t=(before + 1) * PERIOD)
    assert verdict is None or verdict.response == Response.NONE


@pytest.mark.parametrize("name", TABLE)
def test_a_latched_row_stays_until_a_reset_and_others_go(name):
    row, watch = TABLE[name], FaultMonitor({name: TABLE[name]})
    first = run(watch, row, bad(row), ticks_of(row))
    after = run(watch, row, good(row), 3, t=10.0)
    assert after.holding == ()
    assert after.response == (row.code if row.latched else Response.NONE)
    assert after.fault == first.fault
    watch.reset()
    assert run(watch, row, good(row), 1, t=20.0) == QUIET
    assert watch.latched == ()


@pytest.mark.parametrize("name", TABLE)
def test_a_disarmed_vehicle_has_faults_but_none_is_latched(name):
    row, watch = TABLE[name], FaultMonitor({name: TABLE[name]})
    verdict = run(watch, row, bad(row), ticks_of(row), armed=False)
    assert verdict.holding == (name,)
    assert verdict.fault is None
    assert watch.latched == ()


@pytest.mark.parametrize("name", [name for name, row in TABLE.items() if row.latched])
def test_the_operator_reads_what_and_how_much(name):
    row = TABLE[name]
    said = run(FaultMonitor({name: row}), row, bad(row), ticks_of(row)).fault
    fault, what = said.words.split(": ", 1)
    assert fault == name
    assert said.text.endswith(what)
    assert not what.startswith(f"{name.replace('_', ' ')}: ")  # not "leak: leak: 5 %"
    assert "{" not in said.text
    assert (said.id, said.detector, said.value) == (name, row.detector, bad(row))


def test_the_most_severe_wins():
    assert [one.words for one in sorted(Response)] == ["", "warn", "hold", "brake", "coast", "land"]
    watch = FaultMonitor(TABLE)
    warn, brake = TABLE["link_late"], TABLE["battery_low"]
    both = numbers(setpoint_age=bad(warn), battery=bad(brake))
    assert watch.look(0.0, True, both).response == Response.BRAKE
    land = numbers(battery=bad(brake), board_silent=1.0)
    verdict = watch.look(0.1, True, land)
    assert verdict.response == Response.LAND
    assert verdict.fault.id == "board_silent"
    # and it does not get milder again
    assert watch.look(0.2, True, numbers()).response == Response.LAND
    assert watch.latched == ("battery_low", "board_silent")


def test_a_vehicle_that_stops_with_others_reports_whose_fault_it_is(vehicle, table, make_state):
    first = FaultReport("leak", "a leak", "sat2")
    followed = FaultReport("fleet", "stopped with the others", "sat3", cause=first.origin)
    for fleet in (first, followed):
        inputs = Inputs(0.0, True, (), None, {}, Health(0.0, 5e5, 2e7), vitals=Vitals(fleet=fleet))
        safety = Safety(vehicle, table, TABLE)
        fault = safety.act(inputs, 0.0, make_state(), None, Wrench(0, 0, 0), 1.0).fault
        assert fault.text == TABLE["fleet"].text.format(said=fleet.words)
        assert fault.cause == FaultCause("leak", "a leak", "sat2")


ROW = TABLE["pose_lost"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"above": None}, "one of `above` and `below`"),
        ({"below": 1.0}, "one of `above` and `below`"),
        ({"text": "{speed}"}, "{value} and {said} only"),
        ({"text": "{value:q}"}, "{value} and {said} only"),
        ({"text": "{0}"}, "{value} and {said} only"),
        ({"text": "{value:{said}}"}, "{value} and {said} only"),
        ({"text": "{value:{value}}"}, "{value} and {said} only"),
        ({"text": "{value:10000000.1f}"}, "{value} and {said} only"),
        ({"text": "{said.__class__}"}, "{value} and {said} only"),
        ({"text": "{value"}, "{value} and {said} only"),
    ],
)
def test_a_row_that_says_nothing_is_refused(change, words):
    with pytest.raises(ValueError, match=words):
        Fault(**(msgspec.structs.asdict(ROW) | change))


@pytest.mark.parametrize("text", ["{value:.3}", "{value:+.1e}{{}}", "{value!s} of {said:>6}", ""])
@pytest.mark.parametrize("value", [13, 13.7, math.nan, math.inf])
def test_words_that_are_taken_can_be_said_of_every_number(text, value):
    watch = FaultMonitor({"row": Fault("poses_rejected", "brake", text, latched=True, above=12)})
    said = "long " * 1000
    verdict = watch.look(0.0, True, numbers(poses_rejected=value), said)
    assert verdict.fault.id == "row"
    assert len(verdict.fault.text) < 400


@pytest.mark.parametrize(
    "change",
    [{"response": "pray"}, {"detector": "nose"}, {"misses": 0}, {"timeout_s": -1.0}, {"colour": 1}],
)
def test_a_table_is_typed(change):
    tree = msgspec.to_builtins(replace(ROW)) | change
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"row": tree}, FaultTable)


def test_a_full_disk_is_told_in_megabytes():
    agent = make_vehicle(load(find("hold")), "sat1")
    agent.step(Inputs(0.0, True, (), None, {}, Health(0.0, 5e5, 2e7)))
    told = agent.step(
        Inputs(0.1, True, (), None, {}, Health(0.1, 5e5, 2e7), vitals=Vitals(disk_free=9.9e7))
    )
    assert told.fault.words == "disk_full: the disk is nearly full: 99 MB are left"
