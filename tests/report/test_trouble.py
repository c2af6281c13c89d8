"""A fault in words: the culprit first, each sentence once."""

from testbed.config import find, load
from testbed.core.codes import FaultReport, InhibitReason, Refusal, Response
from testbed.core.types import Health, Inputs, Outputs, Tick, ValveCommand, Wrench
from testbed.logs.feed import SeenPhase
from testbed.logs.history import FlightEvent, phase_change
from testbed.report.fault_story import SUPERVISOR, EventLine, FaultyVehicles, Story

SCENARIO = load(find("zhang2023_table"))
STUCK = FaultReport("valve_stuck_open", "pushed by 0.045 m/s^2", detector="jet_open")
STUCK_OF_SAT3 = FaultReport("valve_stuck_open", "pushed by 0.045 m/s^2", "sat3", "jet_open")
OTHERS = FaultReport("fleet", "stopped with the others", "", "fleet", cause=STUCK_OF_SAT3.origin)
SHUT = Refusal(InhibitReason.FAULT)
LONGEST_TITLE = 30  # letters, so that a banner is one line


def tick(t: float, fault=None, response=Response.NONE, shut=None):
    command = ValveCommand(0, t, t + 0.1, (0,) * 8, (0,) * 8)
    still = Wrench(0.0, 0.0, 0.0)
    outputs = Outputs(t, None, None, still, still, command, shut, fault, response=response)
    return Tick(Inputs(t, True, (), None, {}, Health(t, 5e5, 2e7)), outputs)


def test_every_shipped_fault_is_short():
    for name, row in SCENARIO.faults.items():
        title = row.report(name, 1.0, "sat2", None).title
        assert 0 < len(title) <= LONGEST_TITLE


def test_the_banner_names_the_culprit_first():
    trouble = FaultyVehicles(SCENARIO)
    lands = Response.LAND
    trouble.see({"sat1": tick(1.0), "sat2": tick(1.0), "sat3": tick(1.0, STUCK, lands, SHUT)})
    newest = {
        "sat1": tick(1.1, OTHERS, Response.BRAKE), "sat2": tick(1.1, OTHERS, Response.BRAKE, SHUT),
        "sat3": tick(1.1, STUCK, lands, SHUT),
    }  # fmt: skip
    trouble.see(newest)
    assert trouble.culprits(newest) == {"sat3": "valve stuck open"}
    assert trouble.banner(newest) == (
        "FAULT sat3: valve stuck open - landed   |   sat1 braking too   |   sat2 stopped too"
    )


def test_who_cannot_speak_is_named_by_the_others():
    silent = FaultReport("vehicle_silent", "vehicle silent: nothing heard for 0.52 s", "sat2")
    said = FaultReport("fleet", "stopped", detector="fleet", cause=silent.origin)
    brakes = Response.BRAKE
    newest = {"sat1": tick(1.0, said, brakes), "sat2": tick(0.4), "sat3": tick(1.0, said, brakes)}
    trouble = FaultyVehicles(SCENARIO)
    trouble.see(newest)
    assert trouble.banner(newest).startswith("FAULT sat2: vehicle silent - silent   |")


def test_no_fault_no_banner():
    newest = {"sat1": tick(1.0), "sat2": tick(1.0, None, Response.HOLD)}
    trouble = FaultyVehicles(SCENARIO)
    trouble.see(newest)
    assert (trouble.banner(newest), trouble.culprits(newest)) == ("", {})


def response(t, kind, *rows):
    return FlightEvent(t, kind, ", ".join(rows), rows=rows)


def fault(t, report):
    return FlightEvent(t, "fault", report.words, report)


def test_one_sentence_once():
    end = phase_change(SeenPhase(2.9, "FAULT", fault=STUCK_OF_SAT3))
    rows = [
        ("sat1", response(2.1, "brake", "fleet")), ("sat1", fault(2.1, OTHERS)),
        ("sat2", response(2.1, "brake", "fleet")), ("sat2", fault(2.1, OTHERS)),
        ("sat3", FlightEvent(2.0, "valves shut")),
        ("sat3", response(2.0, "land", "valve_stuck_open")), ("sat3", fault(2.0, STUCK)),
        ("sat3", response(2.2, "land", "pose_stale", "fleet")),
        ("sat1", FlightEvent(2.8, "valves shut")), (SUPERVISOR, end),
    ]  # fmt: skip
    lines = Story(SCENARIO).lines_of(rows)
    assert lines == [
        EventLine(2.0, ("sat3",), "CRITICAL", f"fault: {STUCK.words}"),
        EventLine(2.0, ("sat3",), "ERROR", "valves shut"),
        EventLine(2.0, ("sat3",), "ERROR", "land: valve_stuck_open"),
        EventLine(2.1, ("sat1", "sat2"), "ERROR", "stopping with the others"),
        EventLine(2.2, ("sat3",), "ERROR", "land: pose_stale"),
        EventLine(2.8, ("sat1",), "ERROR", "valves shut"),
        EventLine(2.9, (SUPERVISOR,), "CRITICAL", "FAULT: sat3"),
    ]
    assert sum(STUCK.text in line.words for line in lines) == 1


def test_a_fault_that_only_followers_tell_is_told_once():
    raised = FaultReport("host_law_raised", "law on the host: ValueError", "sat2")
    said = FaultReport("fleet", "stopped with sat2", detector="fleet", cause=raised.origin)
    rows = [("sat1", fault(1.0, said)), ("sat3", fault(1.0, said))]
    assert [line.who for line in Story(SCENARIO).lines_of(rows)] == [("sat1",), ("sat3",)]
    words = [line.words for line in Story(SCENARIO).lines_of(rows)]
    assert words == [f"fault: {said.words}", "stopping with the others"]


def test_a_fault_of_the_rig_is_told_by_the_supervisor_only():
    failed = FaultReport("rig_failed", "the network is gone")
    rows = [(SUPERVISOR, phase_change(SeenPhase(1.0, "FAULT", fault=failed)))]
    assert Story(SCENARIO).lines_of(rows)[0].words == "FAULT: the network is gone"
