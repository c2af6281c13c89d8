"""What a report lists: contacts with faults, and what is said often in one line."""

from types import SimpleNamespace

from testbed.config import find, load
from testbed.core.codes import FaultId, FaultReport
from testbed.flight.arming import Check
from testbed.logs.feed import SeenPhase
from testbed.logs.history import FlightEvent, phase_change
from testbed.metrics.run_metrics import Metrics, Touch, VehicleMetrics
from testbed.report.events import happened, lines
from testbed.report.verdict import missed, reasons, verdict

SCENARIO = load(find("zhang2023_table"))
STUCK = FaultReport(
    "valve_stuck_open", "pushed by 0.045 m/s^2 that no command explains", "sat3", "jet_open"
)
STOPPED = FaultReport(FaultId.STOPPED, "stopped by the operator")


def flown(near: float = 0.9, **more) -> Metrics:
    one = VehicleMetrics(0.001, 70.0, 0.001, 0.0005, 0.02, near, 6.0, 18.0, 800, 1.5)
    far = VehicleMetrics(0.001, 71.0, 0.001, 0.0005, 0.2, 1.5, 6.0, 18.0, 800, 1.5)
    words = {
        "experiment": "zhang2023_table", "rig": "twin", "seed": 0, "completed": True,
        "duration_s": 150.0, "wall_s": 2.0, "real_time_factor": 75.0, "contacts": 0,
        "min_vehicle_distance_m": 1.0, "fault": None, "criteria": {},
        "vehicles": {"sat1": one, "sat2": far},
    }  # fmt: skip
    return Metrics(**(words | more))


def history(**events):
    vehicles = {name: SimpleNamespace(events=said) for name, said in events.items()}
    return SimpleNamespace(vehicles=vehicles, phases=[])


def test_what_is_said_often_is_one_line():
    late = [FlightEvent(3.2 + 0.5 * k, "warn", "neighbour_late") for k in range(20)]
    more = [FlightEvent(t, "warn", "neighbour_late") for t in (20.0, 60.1)]
    link = [FlightEvent(5.0, "warn", "link_late")]
    told = lines(SCENARIO, history(sat1=late, sat2=more, sat3=link), [])
    assert [(one.t, one.who, one.words) for one in told] == [
        (3.2, ("sat1", "sat2"), "22 x warn: neighbour_late, first 3.2 s, last 60.1 s"),
        (5.0, ("sat3",), "warn: link_late"),
    ]


def test_faults_are_never_gathered():
    lands = [FlightEvent(float(k), "land", "leak", rows=("leak",)) for k in range(9)]
    told = lines(SCENARIO, history(sat1=lands), [])
    assert len(told) == 9


def test_the_end_of_a_flight_says_who_ended_it():
    ends = history(sat1=[])
    ends.phases = [phase_change(SeenPhase(12.0, "STOPPED", "stop"))]
    assert [(one.level, one.words) for one in lines(SCENARIO, ends, [])] == [
        ("WARN", "stopped by the operator")
    ]


def test_a_contact_is_an_event():
    touches = [Touch(10.2, "sat1", "o1", 0.123), Touch(12.0, "sat1", "sat2", 0.01),
               Touch(13.0, "sat2", "left edge", 0.2)]  # fmt: skip
    said = history(sat1=[FlightEvent(11.0, "fault", STUCK.words, STUCK)], sat2=[])
    page = happened(lines(SCENARIO, said, touches))
    places = [page.index(words) for words in (
        "hit obstacle o1, 12 cm/s", "fault: ", "hit sat2, 1 cm/s",
        "hit the table&#x27;s left edge, 20 cm/s",
    )]  # fmt: skip
    assert places == sorted(places)


def test_nothing_happened():
    assert "None." in happened(lines(SCENARIO, history(sat1=[]), []))


def test_the_colour_of_a_verdict():
    touch = {"touches": [Touch(10.2, "sat1", "o1", 0.123)], "contacts": 1}
    cases = [
        (flown(criteria={"settle_s": True}), ("passed", "passed")),
        (flown(criteria={"settle_s": False}), ("failed", "failed: settled")),
        (flown(criteria={"max_contacts": False, "settle_s": False}, **touch),
         ("fault", "failed: sat1 hit obstacle o1 at 10.2 s, 12 cm/s; settled")),
        (flown(completed=False, duration_s=33.1, fault=STUCK.words),
         ("fault", "aborted by a fault after 33.1 s")),
        (flown(completed=False, duration_s=33.1, fault=STUCK.words, fault_report=STUCK),
         ("fault", "sat3: valve stuck open; aborted by a fault after 33.1 s")),
        (flown(completed=False, duration_s=33.1, fault=STOPPED.words, fault_report=STOPPED),
         ("unjudged", "stopped by the operator after 33.1 s: not judged")),
        (flown(completed=False, duration_s=12.3, criteria=None),
         ("unjudged", "interrupted at 12.3 s: not judged")),
        (flown(criteria={}), ("unjudged", "no criteria to judge")),
        (flown(completed=False, red=[Check("pose", "sat1", "no pose yet")], fault="not started"),
         ("failed", "not started: a check failed")),
        (flown(completed=False, duration_s=9.0, contacts=-1, fault="killed", criteria=None),
         ("unjudged", "not judged, 9.0 s in the log")),
    ]  # fmt: skip
    for metrics, wanted in cases:
        assert verdict(SCENARIO, metrics) == wanted


def test_the_reasons_begin_with_the_first_thing():
    touches = [Touch(1.0 + k, "sat1", "o1", 0.1) for k in range(5)]
    found = reasons(
        SCENARIO, flown(touches=touches, contacts=5, fault=STUCK.words, fault_report=STUCK)
    )
    assert found[0] == "sat1 hit obstacle o1 at 1.0 s, 10 cm/s"
    assert found[3:] == ["2 more contacts", f"sat3: {STUCK.text}"]
    assert reasons(SCENARIO, flown(fault=STOPPED.words, fault_report=STOPPED)) == []
    killed = "the flight was killed before it was judged; gas and contacts are not in the log"
    assert reasons(SCENARIO, flown(fault=killed)) == [killed]


def test_only_the_number_that_misses_is_marked():
    metrics = flown(near=0.5, criteria={"clear_of_obstacles": False, "heading_rms_deg": False,
                                        "settle_s": True})  # fmt: skip
    marked = {
        (name, key)
        for name in metrics.vehicles
        for key, criterion in (
            ("min_obstacle_distance_m", "clear_of_obstacles"), ("settle_s", "settle_s"),
            ("heading_rms_deg", "heading_rms_deg"), ("gas_g", ""),
        )
        if missed(SCENARIO, metrics, name, key, criterion)
    }  # fmt: skip
    assert marked == {("sat1", "min_obstacle_distance_m"), ("sat2", "heading_rms_deg")}
