"""How a rehearsed flight on the bench is judged: by boards and by vehicles' last words."""

import pytest

from sim_twin.plant import Touch
from testbed.config import find, load
from testbed.core.codes import FaultReport, Response
from testbed.core.fault_injection import Injection
from testbed.faults.drill import cases_of
from testbed.flight.arming import Check
from testbed.net.commands import Counts, Ended
from testbed.rig.wired.table_report import TableReport
from testbed.run import drill_on_wires
from testbed.run.drill_on_wires import NOTHING, DrillError, Flown, judge

COUNTS = Counts({}, {}, {}, 0, 0, None, None)
EPOCH = 5_000_000_000  # [ns]
HOLD = load(find("hold"))


def us(t):
    """The boards' stamp at this time of the run."""
    return round(1e-3 * EPOCH + 1e6 * t)


def ended(t, fault, rows, responses):
    return Ended(t, fault, COUNTS, rows, responses)


def flown(edges, last_words, touches=(), fault=None):
    report = TableReport(
        released_ns=EPOCH - 10**9, t=[0.0, 3.0, 6.0],
        states=[[[0.0] * 6], [[0.1] + [0.0] * 5], [[0.4] + [0.0] * 5]],
        touches=list(touches), impulse={}, gas={}, openings={}, late_edges={},
        edges={"sat1": edges}, boards=[], left_as={},
    )  # fmt: skip
    return Flown(EPOCH, report, {"sat1": last_words} if last_words else {}, fault)


def judged(kind, what, row="", experiment=HOLD, **more):
    return judge(Injection(kind, "sat1", at_s=2.0, **more), experiment, what, row)


LOST = FaultReport("pose_lost", "none", "sat1")
SILENT = FaultReport("board_silent", "x", "sat1")
BRAKED = ended(3.5, LOST, {"pose_stale": 2.1}, {Response.WARN: 2.1, Response.BRAKE: 2.5})


def test_a_fault_that_was_named_and_answered():
    found = judged("drop_mocap", flown([(us(1.9), 1), (us(2.6), 0)], BRAKED))
    assert (found.named, found.response, found.late) == ("pose_stale", Response.BRAKE, 0)
    assert found.detected_s == pytest.approx(0.5)  # the brake; the warning comes without a fault
    assert found.shut_s == pytest.approx(0.6)
    assert found.travelled_m == pytest.approx(0.3)
    assert found.fault == LOST


def test_a_vehicle_that_needs_longer_to_stop_has_longer():
    pulse = [(us(10.0), 1), (us(10.1), 0)]  # braking since 2.5 s
    assert HOLD.flight.ending.brake_s == 6.0
    assert judged("drop_mocap", flown(pulse, BRAKED)).late == 1
    heavy = load(find("hold"), ["flight.ending.brake_s=9.0"])
    assert judged("drop_mocap", flown(pulse, BRAKED), experiment=heavy).late == 0


def test_what_was_named_before_it_began_does_not_count():
    early = ended(3.5, None, {"pose_stale": 1.0}, {})
    found = judged("drop_mocap", flown([], early))
    assert found.named == ""
    assert found.detected_s is None


@pytest.mark.parametrize("edges", [[(us(1.9), 5)], [(us(1.9), 5), (us(2.9), 0)]])
def test_valves_that_stay_open_are_counted(edges):
    coasted = ended(2.5, SILENT, {"board_silent": 2.3}, {Response.COAST: 2.3})
    assert judged("brown_out", flown(edges, coasted)).late == 2


def test_a_vehicle_that_cannot_speak_is_judged_by_its_board():
    plan_ran_out = [(us(1.9), 1), (us(2.2), 0)]
    assert judged("kill_process", flown(plan_ran_out, None)).late == 0
    assert judged("kill_process", flown([(us(1.9), 1), (us(2.4), 0)], None)).late == 1


def test_a_vehicle_that_cannot_push_may_drift_into_something():
    touch = Touch(4.0, "sat1", "sat2", 0.03)
    dead = judged("kill_process", flown([], None, [touch]))
    assert (dead.contacts, dead.adrift) == (0, 1)
    alive = judged("drop_mocap", flown([], BRAKED, [touch]))
    assert (alive.contacts, alive.contacts_after, alive.adrift) == (1, 0, 0)
    soft = judged("drop_mocap", flown([], BRAKED, [Touch(5.0, "sat1", "sat2", 0.01)]))
    assert soft.contacts == 0  # after the end of the flight


def test_all_that_can_break_on_wires_is_rehearsed():
    there = set(cases_of("bench", 3))
    assert set(cases_of("twin", 3)) < there
    assert {"cut_serial", "stop_process", "kill_host", "foreign_session", "flood"} <= there


def test_a_process_that_goes_on_after_a_pause_is_judged_as_any_other():
    brakes = ended(3.0, None, {"overrun": 2.3}, {Response.BRAKE: 2.3})
    shut_late = [(us(1.9), 1), (us(3.1), 0)]
    found = judged("stop_process", flown(shut_late, brakes), "pause_process", for_s=0.2)
    assert (found.kind, found.named, found.late) == ("pause_process", "overrun", 0)
    assert found.detected_s == pytest.approx(0.3)


def test_the_response_is_that_of_the_vehicle_concerned():
    brakes = ended(3.0, FaultReport("fleet", "x", "sat2"), {"fleet": 2.4}, {Response.BRAKE: 2.4})
    lands = ended(2.6, SILENT, {"board_silent": 2.3}, {Response.LAND: 2.3})
    cut = flown([], lands)
    cut.ended["sat2"] = brakes
    found = judged("cut_serial", cut)
    assert (found.response, found.detected_s) == (Response.LAND, pytest.approx(0.3))
    # of a dead one the others'
    dead = flown([], None)
    silent = ended(
        3.0, None, {"neighbour_late": 2.5, "neighbour_silent": 3.2}, {Response.BRAKE: 3.2}
    )
    dead.ended["sat2"] = silent
    found = judged("kill_process", dead)
    assert (found.response, found.named) == (Response.BRAKE, "neighbour_silent")
    assert found.detected_s == pytest.approx(1.2)


def test_a_flight_that_does_not_arm_is_judged_by_its_red_checks(monkeypatch):
    red = [Check("supply", "sat1", "no pressure: open the air")]
    monkeypatch.setattr(drill_on_wires, "fly", lambda *_: Flown(0, NOTHING, {}, None, red))
    rows = cases_of("bench", 1)
    found = drill_on_wires.case(rows.index("no_air"), 0, "hold")
    assert (found.kind, found.named, found.refused, found.missed) == (
        "no_air",
        "supply",
        True,
        False,
    )
    with pytest.raises(DrillError, match="sat1 supply: no pressure"):  # such as on a busy machine
        drill_on_wires.case(rows.index("drop_mocap"), 0, "hold")


def test_a_wrong_frame_concerns_every_vehicle():
    last = ended(3.0, LOST, {"pose_jumped": 2.3}, {Response.BRAKE: 2.3})
    moved = flown([], None)
    moved.ended["sat2"] = last
    found = judged("shift_frame", moved, "frame_bumped")
    assert (found.named, found.response) == ("pose_jumped", Response.BRAKE)


def test_a_swap_concerns_both_vehicles():
    swapped = flown([], None)
    fault = FaultReport("pose_swapped", "x", "sat2")
    swapped.ended["sat2"] = ended(3.0, fault, {"pose_swapped": 2.3}, {Response.BRAKE: 2.3})
    found = judged("swap_bodies", swapped, other="sat2")
    assert (found.named, found.response) == ("pose_swapped", Response.BRAKE)
    assert found.detected_s == pytest.approx(0.3)
