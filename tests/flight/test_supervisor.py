"""The supervisor's table, request by request and phase by phase, and the arming checks."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from testbed.core.codes import FaultReport
from testbed.core.types import Health, Pose, Twist, Vitals
from testbed.flight.arming import ArmingParams, Check, Expected, Readiness, arming_checks
from testbed.flight.gate import Fence
from testbed.flight.supervisor import ARMED_FOR, MOVES, Supervisor

GREEN = [Check("pose", "a"), Check("supply", "a", at_reset=False)]
RED = [Check("pose", "a", "no pose yet"), Check("supply", "a", at_reset=False)]
LOW = [Check("pose", "a"), Check("supply", "a", "at 50 %", at_reset=False)]
PHASES = ("DISARMED", "ARMED", "RUNNING", "STOPPED", "FAULT")
REACHED = {  # phase and request, with green checks -> phase, and whether it was done
    ("DISARMED", "arm"): ("ARMED", True),
    ("ARMED", "run"): ("RUNNING", True),
    ("ARMED", "stop"): ("STOPPED", True),
    ("RUNNING", "stop"): ("STOPPED", True),
    ("ARMED", "disarm"): ("DISARMED", True),
    ("RUNNING", "disarm"): ("DISARMED", True),
    ("STOPPED", "reset"): ("DISARMED", True),
    ("FAULT", "reset"): ("DISARMED", True),
}

LOST = FaultReport("pose_lost", "pose lost", "sat1")


def brought_to(phase):
    supervisor = Supervisor()
    if phase in ("ARMED", "RUNNING", "STOPPED", "FAULT"):
        supervisor.request(0.0, "arm", GREEN)
    if phase in ("RUNNING", "STOPPED"):
        supervisor.request(0.0, "run", GREEN)
    if phase == "STOPPED":
        supervisor.request(0.0, "stop")
    if phase == "FAULT":
        supervisor.fail(0.0, "broke")
    assert supervisor.phase == phase
    return supervisor


@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("what", MOVES)
def test_every_request_in_every_phase(phase, what):
    supervisor = brought_to(phase)
    answer = supervisor.request(1.0, what, GREEN)
    harmless = what in ("stop", "disarm")
    to, done = REACHED.get((phase, what), (phase, harmless))
    assert (answer.phase, answer.done) == (to, done)
    assert supervisor.phase == to
    assert bool(answer.red) == (not done)


@pytest.mark.parametrize("phase", PHASES)
def test_valves_may_open_in_running_only(phase):
    assert brought_to(phase).may_fire == (phase == "RUNNING")


@pytest.mark.parametrize(("phase", "what"), [("DISARMED", "arm"), ("ARMED", "run")])
@pytest.mark.parametrize("checks", [RED, LOW])
def test_a_red_check_is_named(phase, what, checks):
    supervisor = brought_to(phase)
    answer = supervisor.request(1.0, what, checks)
    assert not answer.done
    assert answer.red == tuple(one for one in checks if one.reason)
    assert supervisor.phase == phase


@pytest.mark.parametrize(("phase", "what"), [("DISARMED", "arm"), ("FAULT", "reset")])
def test_no_checks_are_no_green_checks(phase, what):
    (red,) = brought_to(phase).request(1.0, what, []).red
    assert red.words == "checks: none was made"


@pytest.mark.parametrize("phase", ["STOPPED", "FAULT"])
def test_a_reset_asks_for_the_state_not_for_the_tank(phase):
    assert not brought_to(phase).request(1.0, "reset", RED).done
    assert brought_to(phase).request(1.0, "reset", LOW).done


def test_a_fault_is_latched_and_the_first_is_kept():
    supervisor = brought_to("RUNNING")
    supervisor.fail(1.0, LOST)
    supervisor.fail(2.0, FaultReport("link_lost", "link lost"))
    assert supervisor.fault == LOST
    for what in ("arm", "run"):
        assert not supervisor.request(3.0, what, GREEN).done
    for what in ("stop", "disarm"):
        supervisor.request(3.0, what)
    assert (supervisor.phase, supervisor.fault) == ("FAULT", LOST)
    assert supervisor.request(4.0, "reset", GREEN).done
    assert (supervisor.phase, supervisor.fault) == ("DISARMED", None)


def test_arming_runs_out():
    supervisor = brought_to("ARMED")
    supervisor.tick(ARMED_FOR)
    assert supervisor.phase == "ARMED"
    answer = supervisor.request(math.nextafter(ARMED_FOR, 1e9), "run", GREEN)
    assert not answer.done
    assert supervisor.phase == "DISARMED"


def test_the_end_of_a_run_stops_it_and_nothing_else():
    for phase in PHASES:
        supervisor = brought_to(phase)
        supervisor.end(1.0)
        assert supervisor.phase == ("STOPPED" if phase == "RUNNING" else phase)


def test_what_happened_is_written_down():
    supervisor = brought_to("RUNNING")
    supervisor.fail(2.0, LOST)
    assert [(e.phase, e.because, e.fault) for e in supervisor.events] == [
        ("ARMED", "arm", None), ("RUNNING", "run", None), ("FAULT", "", LOST),
    ]  # fmt: skip


steps = st.lists(
    st.tuples(
        st.sampled_from([*MOVES, "fail", "end", "tick"]),
        st.sampled_from([GREEN, RED, LOW, []]),
        st.floats(0.0, 100.0),
    ),
    max_size=40,
)


@given(steps)
def test_nothing_fires_that_was_not_armed_and_run_with_green_checks(sequence):
    supervisor, t, armed, running = Supervisor(), 0.0, False, False
    for what, checks, wait in sequence:
        t += wait
        if what == "fail":
            supervisor.fail(t, "broke")
            armed = running = False
        elif what == "end":
            supervisor.end(t)
            running = False
        elif what == "tick":
            supervisor.tick(t)
        else:
            done = supervisor.request(t, what, checks).done
            if what == "arm" and done:
                armed = checks is GREEN
            elif what == "run" and done:
                running = armed and checks is GREEN
            elif what in ("stop", "disarm", "reset"):
                running = running and not done
        assert supervisor.may_fire <= running


# Arming checks


PARAMS = ArmingParams()
EXPECTED = Expected("a", 100.0, 5e5, 12.0, Fence(2.8, 2.8), (0.1, 0.0, 0.2), {"b": 0.4}, 0.03)


@pytest.fixture
def ready(make_state):
    return Readiness(
        10.0, make_state((0.1, 0.0, 0.2), t=10.0), 100.0, Health(10.0, 5e5, 2e7), Vitals(),
        0.01, True, {"b": make_state((0.68, 0.0, 0.0), t=10.0)},
    )  # fmt: skip


def red(ready):
    return {c.name: c.reason for c in arming_checks(ready, EXPECTED, PARAMS) if c.reason}


def test_all_green_when_all_is_well(ready):
    assert red(ready) == {}
    assert len(arming_checks(ready, EXPECTED, PARAMS)) == 20


ROWS = [
    ("a pose", {"pose_age": 0.11}),
    ("a pose", {"pose_age": -0.11}),
    ("a pose", {"pose_age": math.nan}),
    ("a estimate", {"rejected": 3}),
    ("a start", {"pose": Pose(0.1, 0.031, 0.2)}),
    ("a heading", {"pose": Pose(0.1, 0.0, 0.2 - math.radians(20.1))}),
    ("a at rest", {"twist": Twist(0.011, 0.0, 0.0)}),
    ("a spin", {"twist": Twist(0.0, 0.0, -0.051)}),
    ("a spin", {"twist": Twist(0.0, 0.0, math.nan)}),
]


@pytest.mark.parametrize(("name", "change"), ROWS)
def test_a_bad_state_is_red(name, change, ready):
    assert list(red(replace(ready, state=replace(ready.state, **change)))) == [name]


def test_two_vehicles_close_to_each_other_are_red(ready, make_state):
    near = replace(ready, neighbours={"b": make_state((0.54, 0.0, 0.0), t=10.0)})
    (found,) = [one for one in arming_checks(near, EXPECTED, PARAMS) if one.reason]
    assert (found.name, found.id, found.other) == ("a clear of b", "clear_of", "b")
    assert (found.value, found.least) == (pytest.approx(0.04), 0.05)


def test_the_place_of_the_start_is_as_exact_as_the_room_that_the_filter_keeps(ready):
    def off(y, expected, params=PARAMS):
        state = replace(ready.state, pose=Pose(0.1, y, 0.2))
        checks = arming_checks(replace(ready, state=state), expected, params)
        return [one.id for one in checks if one.reason]

    assert off(0.029, EXPECTED) == []
    assert off(0.031, EXPECTED) == ["start"]
    assert off(0.031, replace(EXPECTED, room=0.05)) == []
    assert off(0.009, replace(EXPECTED, room=0.0)) == []
    assert off(0.1, EXPECTED, ArmingParams(start_distance=0.15)) == []


def test_a_red_check_has_its_value_and_its_limits(ready):
    low = replace(ready, health=Health(10.0, 4e5, 2e7, battery=math.nan))
    supply, battery = (one for one in arming_checks(low, EXPECTED, PARAMS) if one.reason)
    assert (supply.id, supply.vehicle, supply.value) == ("supply", "a", pytest.approx(0.8))
    assert (supply.least, supply.most) == (0.95, 1.1)
    assert (battery.id, battery.value) == ("battery", None)


@pytest.mark.parametrize("place", [Pose(2.81, 0.0, 0.2), Pose(0.0, -2.81, 0.2)])
def test_beyond_the_fence_is_red_wherever_it_was_to_start(place, ready):
    far = replace(ready, state=replace(ready.state, pose=place))
    assert list(red(far)) == ["a fence", "a start"]


def test_no_air_and_no_battery_are_red_and_say_what_to_do(ready):
    reasons = red(replace(ready, health=Health(10.0, 0.0, 0.0, battery=0.0)))
    assert list(reasons) == ["a supply", "a battery"]
    assert "open the air" in reasons["a supply"]
    assert "`[gauges] supply = false`" in reasons["a supply"]
    assert "`[gauges] battery = false`" in reasons["a battery"]


def test_the_limits_of_a_battery_follow_its_nominal_voltage(ready):
    strong = replace(EXPECTED, battery_v=24.0)

    def battery(volts, params=PARAMS):
        checks = arming_checks(replace(ready, health=Health(10.0, 5e5, 2e7, volts)), strong, params)
        return next(one for one in checks if one.id == "battery")

    assert (battery(24.0).least, battery(24.0).most) == (22.0, 32.0)
    assert not battery(24.0).reason
    assert battery(12.0).reason == "12.0 V"
    assert battery(21.0, ArmingParams(battery=20.0)).reason == ""


def test_the_heading_is_compared_round_the_circle(ready):
    turned = replace(ready.state, pose=Pose(0.1, 0.0, 0.2 + 2.0 * math.pi))
    assert red(replace(ready, state=turned)) == {}


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("a pose", {"state": None}), ("a pose rate", {"pose_rate": 79.0}),
        ("a pose rate", {"pose_rate": 121.0}), ("a supply", {"health": Health(0.0, 5.6e5, 2e7)}),
        ("a battery", {"health": Health(0.0, 5e5, 2e7, battery=16.1)}),
        ("a battery", {"health": Health(0.0, 5e5, 2e7, battery=math.nan)}),
        ("a board", {"health": None}), ("a supply", {"health": Health(0.0, 4.7e5, 2e7)}),
        ("a battery", {"health": Health(0.0, 5e5, 2e7, battery=10.9)}),
        ("a board", {"health": Health(0.0, 5e5, 2e7, silent_s=0.2)}),
        ("a valves", {"valves_shut": False}), ("a link", {"round_trip": 0.2}),
        ("a link", {"round_trip": math.nan}), ("a clock", {"vitals": Vitals(clock_offset=-0.02)}),
        ("a session", {"vitals": Vitals(session_ok=False)}),
        ("a config", {"vitals": Vitals(same_config=False)}),
        ("a disk", {"vitals": Vitals(disk_free=1e8)}),
        ("a operator", {"vitals": Vitals(operator_age=0.6)}),
        ("a law", {"vitals": Vitals(law_error="ValueError")}),
    ],
)  # fmt: skip
def test_whatever_else_is_bad_is_red(name, change, ready):
    found = red(replace(ready, **change))
    assert list(found) == [name]
    assert found[name]


def test_a_full_disk_is_told_in_megabytes(ready):
    assert red(replace(ready, vitals=Vitals(disk_free=1e8)))["a disk"] == "100 MB free"
