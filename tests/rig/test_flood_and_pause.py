"""A flood and a host that did not run are named, and not the faults that follow from them."""

from testbed.core.codes import FaultCause, FaultId, FaultReport
from testbed.rig.wired.flood import FloodWatch
from testbed.rig.wired.pause import Pause

LINK = FaultReport("link_out", "no valid setpoint for 0.30 s: holding", "sat1", "setpoint_overdue")
JET = FaultReport("valve_stuck_open", "jet 3 gives 90%", "sat1", "jet_open")


def flooded(rates, seconds=2.0):
    """A watch that has seen so many messages a second, each half second."""
    counts = dict.fromkeys(rates, 0)
    watch = FloodWatch(
        lambda: {port: n for port, n in counts.items() if port != "cameras"},
        lambda: counts.get("cameras", 0),
    )
    for k in range(1, round(2 * seconds) + 1):
        counts = {port: round(0.5 * k * rate) for port, rate in rates.items()}
        watch.look(0.5 * k)
    return watch


def test_a_flood_of_setpoints_is_the_fault_and_keeps_the_words_of_what_it_did():
    watch = flooded({"setpoints": 10_000, "leases": 10})
    found = watch.blamed(LINK)
    assert watch.since == 0.5
    assert (found.id, found.vehicle) == (FaultId.FLOODED, "sat1")
    assert found.text == "a flood: 10000 messages a second at its port for setpoints"
    assert found.notes == (LINK.words,)


def test_the_messages_of_a_flight_are_no_flood():
    watch = flooded({"setpoints": 50, "leases": 10, "states of sat2": 50, "cameras": 5})
    assert watch.since is None
    assert watch.blamed(LINK) is LINK


def test_a_flood_is_not_blamed_for_a_jet():
    assert flooded({"setpoints": 10_000}).blamed(JET) is JET


def test_a_flood_at_the_port_of_the_cameras_explains_missing_poses():
    lost = FaultReport("pose_lost", "no pose for 3.00 s", "sat1", "pose_age")
    assert flooded({"cameras": 1000}).blamed(lost).id is FaultId.FLOODED
    assert flooded({"setpoints": 1000}).blamed(lost) is lost


def paused(*gaps_s, turn_s=0.0):
    """The host's loop, with these times between its turns, which take some time themselves."""
    now = [0]
    pause = Pause(lambda: now[0])
    for gap in (0.1, *gaps_s, 0.1):
        pause.turn_begins(1e-9 * now[0])
        now[0] += round(1e9 * turn_s)
        pause.turn_ends()
        now[0] += round(1e9 * gap)
    pause.turn_begins(1e-9 * now[0])
    return pause


def test_a_host_that_did_not_run_is_the_fault_and_not_the_silent_vehicle():
    silent = FaultReport(FaultId.VEHICLE_SILENT, "vehicle silent: not heard for 2.1 s", "sat1")
    found = paused(0.1, 2.1).blamed(silent)
    assert (found.id, found.vehicle) == (FaultId.HOST_SUSPENDED, "")
    assert found.text.startswith("the host did not run for 2.1 s (until t = 2.3 s)")
    assert found.notes == ("sat1: vehicle silent: not heard for 2.1 s",)


def test_a_late_turn_is_no_pause_and_a_pause_is_not_blamed_for_a_jet():
    assert paused(0.7).blamed(LINK) is LINK
    assert paused(2.0).blamed(JET) is JET


def test_a_slow_law_is_no_pause():
    assert paused(0.1, turn_s=1.5).blamed(LINK) is LINK


def test_a_fault_of_the_fleet_counts_with_its_cause():
    gone = FaultCause("operator_gone", "no sign of the operator for 1.0 s", "sat2")
    fleet = FaultReport("fleet", "stopped with the others", "sat1", "fleet", 1.0, gone)
    assert paused(1.5).blamed(fleet).id is FaultId.HOST_SUSPENDED
