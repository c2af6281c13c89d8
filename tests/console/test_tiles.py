"""A vehicle's numbers against its own limits, its valves, and the arming checklist."""

import math
from pathlib import Path

import pytest
from msgspec.structs import replace

from testbed.config import find, load
from testbed.console.checklist import TO_DO, items_of, read_checks, write_checks
from testbed.console.picture import LivePicture
from testbed.console.tiles import Bounds, Gas, bounds
from testbed.console.valve_pulses import ValveHistory
from testbed.core.codes import FaultReport, Response
from testbed.core.types import (
    Accel,
    Health,
    Inputs,
    Outputs,
    Pose,
    State,
    Tick,
    Twist,
    ValveCommand,
    Wrench,
)
from testbed.flight.arming import Check
from testbed.logs.feed import News, SeenPhase, SeenValves

JETS = (0,) * 8
STILL = Wrench(0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def experiment():
    return load(find("zhang2023_table"), [])


def tick(t=1.0, *, age=0.02, x=0.1, y=-1.4, vy=0.0, on=JETS, health=None, **out):
    state = State(t, Pose(x, y, 0.0), Twist(0.0, vy, 0.0), Accel(0.0, 0.0, 0.0), age, 0)
    command = ValveCommand(1, t, t + 0.1, on, JETS)
    return Tick(
        Inputs(t, True, (), None, {}, health or Health(t, 5e5, 3e7)),
        Outputs(t, state, None, STILL, STILL, command, **out),
    )


def seen(experiment, *messages, who="sat2"):
    picture = LivePicture(experiment)
    picture.take([News(f"/{who}/tick", who, one.inputs.t, one) for one in messages])
    return picture


def numbers(picture, name="sat2"):
    car = next(one for one in picture.now()["vehicles"] if one["name"] == name)
    return {one.key: one for one in car["numbers"]}, car


def test_limits_are_those_of_the_fault_table(experiment):
    assert bounds(experiment, "pose_age") == Bounds(0.048, 3.0, is_floor=False)
    assert bounds(experiment, "supply_share") == Bounds(0.9, 0.7, is_floor=True)
    assert bounds(experiment, "battery") == Bounds(-math.inf, 10.5, is_floor=True)
    own = replace(experiment, faults={})
    assert bounds(own, "battery").level(0.0) == "ok"
    assert [Bounds(2.0, 3.0, is_floor=False).level(v) for v in (1, 2.5, 4)] == ["ok", "warn", "bad"]
    assert [Bounds(3.0, 2.0, is_floor=True).level(v) for v in (4, 2.5, 1)] == ["ok", "warn", "bad"]


@pytest.mark.parametrize(
    ("changed", "key", "level"),
    [
        ({}, "pose", "ok"),
        ({"age": 0.1}, "pose", "warn"),
        ({"age": 3.1}, "pose", "bad"),
        ({"health": Health(1.0, 4.2e5, 3e7)}, "supply", "warn"),
        ({"health": Health(1.0, 3.0e5, 3e7)}, "supply", "bad"),
        ({"health": Health(1.0, 5e5, 3e7, battery=10.0)}, "battery", "bad"),
        ({"x": -1.0, "y": -0.95}, "room", "warn"),  # o1's danger radius ends at y = -0.9
        ({"x": -1.0, "y": -0.5}, "room", "bad"),
        ({"y": -2.0, "vy": 0.5}, "room", "warn"),
    ],
)
def test_a_number_turns_amber_and_red_at_the_vehicles_own_limits(experiment, changed, key, level):
    found, _ = numbers(seen(experiment, tick(**changed)))
    assert found[key].level == level, found[key]


def test_gas_is_told_in_minutes_at_this_rate():
    gas = Gas(empty=1e6, full=3e7)
    assert gas.number(3e7, 60.0).text == "100%"
    for t in range(11):
        gas.see(float(t), 3e7 - 1e5 * t)
    assert gas.left_s(2.9e7) == pytest.approx(280.0)
    assert gas.number(2.9e7, 60.0)[2:4] == ("4.7 min, 97%", "ok")
    assert gas.number(2.9e7, 400.0).level == "warn"
    assert gas.number(2.9e7, 600.0).level == "bad"
    assert gas.number(0.0, 1.0).level == "off"


def test_a_fault_names_its_vehicle_and_what_it_says(experiment):
    fault = FaultReport("valve_stuck_open", "valve stuck open?", detector="jet_open")
    picture = seen(experiment, tick(1.0), tick(1.1, fault=fault, response=Response.LAND))
    _, car = numbers(picture)
    assert (car["level"], car["culprit"]) == ("bad", True)
    assert car["state"].startswith("FAULT: valve stuck open")
    assert picture.now()["head"].startswith("FAULT sat2: valve stuck open")
    assert [one.level for one in picture.events if "fault" in one.words] == ["CRITICAL"]


def test_a_vehicle_that_tells_nothing_is_silent(experiment):
    picture = seen(experiment, tick(1.0))
    picture.take([News("/supervisor", "supervisor", 0.0, SeenPhase(0.0, "RUNNING", "run"))])
    picture.take([News("/sat1/tick", "sat1", 3.5, tick(3.5))])
    _, car = numbers(picture)
    assert (car["state"], car["level"]) == ("silent for 2.5 s", "bad")
    assert numbers(picture, "sat3")[1]["state"] == "not heard yet"


@pytest.mark.parametrize("heard", [True, False])
def test_a_silent_vehicle_that_ends_the_flight_is_red(experiment, heard):
    fault = FaultReport("vehicle_silent", "vehicle silent: nothing heard for 0.61 s", "sat2")
    picture = seen(experiment, *[tick(1.0)] * heard)
    phase = SeenPhase(1.6, "FAULT", "", fault)
    picture.take([News("/sat1/tick", "sat1", 3.5, tick(3.5)),
                  News("/supervisor", "supervisor", 1.6, phase)])  # fmt: skip
    _, car = numbers(picture)
    assert car["level"] == "bad"
    assert car["state"].startswith("FAULT: vehicle silent")
    assert numbers(picture, "sat1")[1]["level"] == "off"


def test_valves_are_as_planned_until_the_board_reports():
    pulses = ValveHistory(2, 8, 0.05)
    on = (0, 20_000, *JETS[2:])
    (one,) = pulses.planned(tick(1.0, on=on))
    assert one[:2] == (2, 1)
    assert one[2:] == pytest.approx((1.05, 1.07))
    assert pulses.driven(SeenValves(1.0, 0b10)) == []
    assert pulses.open == [(2, 1, 1.0, 1.0)]
    assert pulses.driven(SeenValves(1.1, 0)) == [(2, 1, 1.0, 1.1)]
    assert pulses.planned(tick(2.0, on=on)) == []


def test_the_checklist_says_what_to_do(tmp_path):
    found = [
        Check("pose", "sat1", "no pose yet"), Check("disk", "sat1"),
        Check("clear_of", "sat2", "0.01 m", other="sat1"),
    ]  # fmt: skip
    write_checks(tmp_path, found)
    pose, disk, clear = read_checks(tmp_path)
    assert (pose.reason, disk.reason) == ("no pose yet", "")
    assert "markers" in pose.to_do
    assert "move one" in clear.to_do
    (red,) = items_of([Check("battery", "sat1: left", "9.0 V: charge")])  # a colon splits nothing
    assert (red.name, red.reason) == ("sat1: left battery", "9.0 V: charge")
    assert red.to_do == TO_DO["battery"]
    write_checks(tmp_path / "gone", [])  # a disk that cannot be written is a check of its own
    assert read_checks(tmp_path / "gone") == []


def test_every_arming_check_has_something_to_do():
    page = Path(__file__).resolve().parents[2] / "docs" / "first_flight_on_the_table.md"
    table = page.read_text().partition("## What a red check means")[2]
    names = {row.split("`")[1].partition(":")[0] for row in table.splitlines() if row[:3] == "| `"}
    assert len(names) > 15
    assert [
        name for name in names if name.replace(" ", "_").removesuffix("_NAME") not in TO_DO
    ] == []
