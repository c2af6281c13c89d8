"""Admission and drill: judged by numbers; the flights themselves are short ones."""

import json
import re
import shlex

import msgspec
import numpy as np
import pytest
from msgspec.structs import replace

from testbed.cli.admit import fly_once, forced, print_admission
from testbed.cli.drill import print_drill
from testbed.config import ConfigError, find, load
from testbed.config.fault_schedule import bad_injections
from testbed.core.codes import FaultCause, FaultId, FaultReport, Response
from testbed.faults.catalogue import CATALOGUE
from testbed.faults.drill import WHEN, Drilled, called, cases_of, draw, refused, summarise
from testbed.flight.arming import Check
from testbed.metrics.admission import (
    AdmissionFlight,
    AdmissionParams,
    judge_flights,
    nearest_edge,
    nearest_rims,
)
from testbed.metrics.fault_line import fault_line
from testbed.metrics.run_metrics import Track
from testbed.run.drill import EXPERIMENTS, case, drawn, fly_case

GOOD = AdmissionFlight(3, None, 0, 0.5, 0.4, 0.3, 0.2, 100.0)


@pytest.mark.parametrize(
    ("change", "broken"),
    [
        ({}, []),
        ({"fault": FaultReport("broke", "broke")}, ["flights that end in a fault"]),
        ({"contacts": 1}, ["contacts"]),
        ({"edge_m": 0.049}, ["room to the fence"]),
        ({"edge_m": 0.05}, []),
        ({"separation_m": -0.1}, ["room between two vehicles"]),
        ({"separation_m": None, "solid_m": None}, []),
        ({"solid_m": 0.0}, ["room to a solid obstacle"]),
        ({"gas_share": 0.81}, ["gas used"]),
        ({"openings_per_valve": 20_001.0}, ["openings of a valve"]),
    ],
)
def test_the_worst_flight_decides(change, broken):
    flights = [GOOD, replace(GOOD, seed=7, **change), replace(GOOD, seed=8)]
    admission = judge_flights("x", flights, AdmissionParams())
    assert [one.name for one in admission.findings if not one.kept] == broken
    assert admission.admitted == (not broken)
    if broken:
        assert next(one.seed for one in admission.findings if not one.kept) == 7


def test_a_refusal_says_the_numbers(capsys):
    print_admission(judge_flights("x", [replace(GOOD, edge_m=0.01)], AdmissionParams()))
    said = " ".join(capsys.readouterr().out.split())
    assert "refused: room to the fence" in said
    assert "0.010 m, at least 0.05 m" in said


def test_each_flight_that_ended_in_a_fault_is_named(capsys):
    stuck = FaultReport("valve_stuck_closed", "jet 4 gives no thrust", "sat1", "jet_missing")
    flights = [GOOD, replace(GOOD, seed=7, fault=stuck, fault_t=12.34), replace(GOOD, seed=8)]
    print_admission(judge_flights("x", flights, AdmissionParams()))
    said = capsys.readouterr().out
    assert "  seed 7: valve_stuck_closed of sat1 at 12.3 s: jet 4 gives no thrust\n" in said
    assert "  see it: testbed run --seed 7\n" in said


def test_admit_says_how_to_see_the_worst_flight(testbed):
    result = testbed("admit", "hold", "duration_s=3", "faults.battery_low.below=12.5",
                     "--flights", "1")  # fmt: skip
    assert result.exit_code == 1
    again = "testbed run hold duration_s=3 faults.battery_low.below=12.5 --seed 0"
    assert f"  see it: {again}\n" in result.stdout


def test_admit_flies_and_says_when_the_fault_was_found():
    early = ["duration_s=3", "faults.battery_low.below=12.5"]
    flown = fly_once(load(find("hold"), early), 5)
    assert (flown.fault.vehicle, flown.fault.id) == ("sat1", "battery_low")
    assert flown.fault_t is not None
    assert flown.fault_t < 0.5


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (FaultReport("battery_low", "battery low: 9 V", "sat1", "battery"),
         "battery_low of sat1 at 2.0 s: 9 V"),
        (FaultReport(FaultId.LOG_FAILED, "log: No space left on device"),
         "log: No space left on device at 2.0 s"),
        (FaultReport("too_fast", "too fast: 9 m/s", "sat-2"), "sat-2: too fast: 9 m/s at 2.0 s"),
        (FaultReport("law_raised", "two\n  lines", "a", "law_error", notes=("and more",)),
         "law_raised of a at 2.0 s: two lines; and more"),
    ],
)  # fmt: skip
def test_a_fault_in_one_line(fault, words):
    assert fault_line(3, fault, 2.0) == f"seed 3: {words}"
    assert fault_line(None, fault, 2.0) == words


def declined(_):
    raise EOFError


def test_force_needs_the_name_and_no_other_word():
    assert forced("hold", lambda _: "hold")
    assert not forced("hold", declined)
    assert not any(forced("hold", lambda _, word=word: word) for word in ("y", "yes", "", "HOLD"))


def test_room_is_measured_from_rim_to_rim():
    states = np.zeros((2, 2, 6))
    states[:, 1, 0] = [1.0, 0.7]
    track = Track(np.arange(2.0), states)
    assert nearest_rims(track, [0.2, 0.2]) == pytest.approx(0.3)
    assert nearest_rims(Track(np.arange(2.0), states[:, :1]), [0.2]) is None
    assert nearest_edge(track, [(2.8, 2.8), (2.8, 2.8)]) == pytest.approx(1.8)


def test_the_table_of_a_drill_fits_into_80_columns(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    cases = [
        replace(CASE, kind=kind, response=Response.BRAKE, detected_s=12.34) for kind in CATALOGUE
    ]
    print_drill(summarise("bench", cases), [])
    table = capsys.readouterr().out.partition("undetected:")[0]
    assert max(map(len, table.splitlines())) <= 80
    assert "…" not in table
    for kind in CATALOGUE:
        assert re.search(rf"^{kind} +brake +1 +0 ", table, re.MULTILINE)


CASE = Drilled(
    "leak",
    "x",
    "a",
    0,
    3.0,
    "supply_low",
    0.2,
    Response.BRAKE,
    1.0,
    0,
    0,
    0.1,
    FaultReport("b", "", "a"),
    (),
    0,
    dormant=False,
)


def test_a_drill_counts_what_went_wrong():
    cases = [
        CASE, replace(CASE, detected_s=None, named=""), replace(CASE, contacts=1, late=2),
        replace(CASE, kind="stick_closed", detected_s=None, dormant=True),
        replace(CASE, early=("too early",)),
    ]  # fmt: skip
    drill = summarise("twin", cases)
    tree = json.loads(msgspec.json.encode(drill))
    assert {"injections", "undetected", "valves_open_after_deadline", "contacts", "rows"} <= set(
        tree
    )
    assert (drill.injections, drill.undetected, drill.dormant) == (5, 1, 1)
    assert (drill.valves_open_after_deadline, drill.contacts, drill.false_alarms) == (2, 1, 1)
    assert drill.rows[0].detected_worst_s == 0.2


def test_a_wrong_name_is_counted_and_its_words_are_printed(capsys):
    names = CATALOGUE["leak"].names
    wrong = FaultReport("valve_leaks", "jet 3 leaks", "a")
    cases = [
        replace(CASE, called=one, said=said, rightly=rightly)
        for one, said, rightly in (
            called(FaultReport("leak", "5 % of the tank", "a"), [], names),
            called(wrong, [(3.1, "supply_weak")], names),
            called(None, [], names),
        )
    ]
    drill = summarise("twin", cases)
    row = drill.rows[0]
    assert (row.rightly, row.judged, row.called) == (1, 2, {"leak": 1, "valve_leaks": 1})
    print_drill(drill, cases)
    said = capsys.readouterr().out
    assert "named: 1 of 2 answers have the right name" in said
    assert said.count("was called") == 1
    assert "leak was called valve_leaks: a: jet 3 leaks" in said


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        ([(3.2, "pulled"), (3.1, "supply_weak")], ("supply_weak", True)),
        ([(3.1, "pulled"), (3.2, "supply_weak")], ("pulled", False)),
        ([(3.1, "pose_stale"), (3.2, "supply_weak")], ("supply_weak", True)),  # as without a fault
        ([(3.1, "pose_stale")], ("", None)),
    ],
)
def test_a_flight_that_went_on_is_judged_by_its_first_warning(rows, told):
    found, _, rightly = called(None, rows, CATALOGUE["leak"].names)
    assert (found, rightly) == told


def test_a_fault_of_another_vehicle_is_named_by_its_origin():
    own = FaultReport("fleet", "stopped", "b", cause=FaultCause("leak", "5 %", "a"))
    assert called(own, [], ("leak",))[::2] == ("leak", True)


@pytest.mark.parametrize("value", [0.025, 0.05, 0.1])
def test_a_clock_that_steps_is_not_called_a_frame_that_moved(value):
    words = f'{{kind="clock_step",vehicle="sat1",at_s=6.03,value={value}}}'
    found = flown("zhang2023_table", words, 9.0)
    assert (found.called, found.rightly) == ("clock_off", True)


def test_a_failed_case_is_printed_with_the_command_that_flies_it_again(capsys):
    cases = [CASE, replace(CASE, contacts=1, again="testbed run hold --seed 5")]
    print_drill(summarise("twin", cases), cases)
    said = capsys.readouterr().out
    assert said.count("    testbed run hold --seed 5\n") == 1
    assert '"seed":0' in said


def test_a_drill_of_one_experiment_flies_it_and_its_command_repeats_the_case():
    one = case(0, 3, ("hold",))
    words = shlex.split(one.again)
    assert words[:3] == ["testbed", "run", "hold"]
    again = load(find("hold"), [*words[3:-2], f"seed={words[-1]}"])
    assert fly_case(again, again.inject[0]) == replace(one, again="")
    # one vehicle cannot be taken for another, or miss another
    alone = set(cases_of("twin", 2)) - set(cases_of("twin", 1))
    assert alone == {"swap_bodies", "swap_boards", "kill_process"}


def test_a_drill_of_an_experiment_that_is_not_there(testbed):
    assert testbed("drill", "nowhere").exit_code == 2
    assert testbed("drill", "nowhere", "--rig", "bench").exit_code == 2


def test_a_drill_of_an_experiment_flies_it_on_the_bench_too(testbed, monkeypatch):
    asked = []

    def fly(*given):
        asked.append((given[0], given[1], given[3]))
        yield replace(CASE, kind="cut_serial")

    monkeypatch.setattr("testbed.run.drill_on_wires.drill_wires", fly)
    result = testbed("drill", "hold", "--rig", "bench", "--seed", "3")
    assert asked == [(len(cases_of("bench", 1)), 3, "hold")]
    assert result.exit_code == 0
    assert "cut_serial" in result.stdout


@pytest.mark.parametrize("period", [0.02, 0.1, 1.0])
@pytest.mark.parametrize("name", CATALOGUE)
def test_whatever_is_drawn_can_be_injected(name, period):
    case, rng, experiment = CATALOGUE[name], np.random.default_rng(0), load(find("zhang2023_table"))
    for _ in range(20):
        what = draw(name, list(experiment.vehicles), 8, period, rng)
        assert what.kind == case.kind
        assert what.at_s == 0.0 if case.at_start else WHEN[0] <= what.at_s <= WHEN[1]
        assert what.other != what.vehicle
        size = what.size / (period if case.in_periods else 1.0)
        assert case.range is None or case.range[0] - 1e-3 <= size <= case.range[1] + 1e-3
        assert list(bad_injections(replace(experiment, inject=[what]))) == []


@pytest.mark.parametrize(
    ("name", "check"),
    [
        ("origin_moved", "start"), ("body_turned", "heading"), ("frame_turned", "start"),
        ("y_axis_up", "start"), ("millimetres", "fence"), ("no_air", "supply"),
        ("high_supply", "supply"),
    ],
)  # fmt: skip
def test_what_is_wrong_before_the_flight_does_not_arm(name, check):
    found = drawn(name, "zhang2023_table", np.random.default_rng(1))
    assert (found.named, found.refused, found.response) == (check, True, Response.NONE)
    assert (found.missed, found.early, found.travelled_m) == (False, (), 0.0)
    row = summarise("twin", [found]).rows[0]
    assert (row.response, row.undetected) == ("not armed", 0)


def test_a_check_that_does_not_name_the_fault_is_no_detection():
    rng, low = np.random.default_rng(1), [Check("battery", "sat1", "9.0 V")]
    found = refused("no_air", "x", draw("no_air", ["sat1"], 8, 0.1, rng), 0, low)
    assert found.missed
    assert found.early == ("sat1 battery: 9.0 V",)


def test_only_a_case_that_may_pass_is_not_missed_without_a_response():
    silent = replace(CASE, detected_s=None, named="")
    assert silent.missed
    assert not replace(silent, kind="frame_creeps").missed
    drill = summarise("twin", [silent, replace(silent, kind="frame_creeps")])
    assert [(row.undetected, row.unnoticed) for row in drill.rows] == [(1, 0), (0, 1)]


# Injected faults in an experiment file


@pytest.mark.parametrize(
    ("inject", "words"),
    [
        ('{kind="leak",vehicle="sat9",at_s=1.0}', "one of: sat1"),
        ('{kind="leek",vehicle="sat1",at_s=1.0}', "one of: "),
        ('{kind="stick_open",vehicle="sat1",at_s=1.0,jet=9}', "a jet from 1 to 8"),
        ('{kind="leak_valve",vehicle="sat1",at_s=1.0,value=30}', "at most 1: 30 % is 0.3"),
        ('{kind="leak_valve",vehicle="sat1",at_s=1.0,value=0}', "more than 0"),
        ('{kind="swap_jets",vehicle="sat1",at_s=1.0,jet=2,value=2}', "the number of the other jet"),
        ('{kind="swap_jets",vehicle="sat1",at_s=1.0}', "the number of the other jet"),
        ('{kind="swap_boards",vehicle="sat1",at_s=1.0}', "`other` with a swap"),
        ('{kind="slow_mocap",vehicle="sat1",at_s=1.0,value=0}', "more than 0"),
        ('{kind="leak",vehicle="sat1"}', "one of `at_s` and `event`"),
        ('{kind="leak",vehicle="sat1",event="near_edge"}', "threshold"),
        ('{kind="swap_bodies",vehicle="sat1",at_s=1.0}', "`other` with a swap"),
        ('{kind="swap_bodies",vehicle="sat1",other="sat1",at_s=1.0}', "another one of"),
        ('{kind="leak",vehicle="sat1",event="near_obstacle",threshold=1.0}', "can happen"),
        ('{kind="leak",vehicle="sat1",event="near_vehicle",threshold=1.0}', "can happen"),
    ],
)
def test_an_injection_that_cannot_be_is_refused(inject, words):
    with pytest.raises(ConfigError) as raised:
        load(find("hold"), [f"inject=[{inject}]"])
    assert words in str(raised.value)


LOST = 'inject=[{kind="lose_link",vehicle="sat1",at_s=2.03}]'


def flown(name, inject, duration):
    experiment = load(find(name), [f"duration_s={duration}", f"inject=[{inject}]", "seed=1"])
    return fly_case(experiment, experiment.inject[0])


@pytest.mark.parametrize(
    ("inject", "named", "response", "within"),
    [
        ('{kind="drop_mocap",vehicle="sat1",at_s=2.03}', "pose_missing", "brake", 0.6),
        ('{kind="freeze_mocap",vehicle="sat1",at_s=2.03}', "pose_frozen", "brake", 0.16),
        ('{kind="jump_mocap",vehicle="sat1",at_s=2.03}', "pose_jumped", "brake", 0.3),
        ('{kind="stick_open",vehicle="sat1",at_s=2.03,jet=3}', "valve_stuck_open", "land", 1.3),
        ('{kind="leak_valve",vehicle="sat1",at_s=2.03,jet=3}', "valve_leaks", "land", 2.3),
        ('{kind="brown_out",vehicle="sat1",at_s=2.03}', "battery_low", "land", 0.15),
        ('{kind="clock_step",vehicle="sat1",at_s=2.03}', "clock_off", "brake", 0.3),
        ('{kind="nan_law",vehicle="sat1",at_s=2.03}', "host_law", "brake", 0.3),
        ('{kind="raise_law",vehicle="sat1",at_s=2.03}', "host_law", "brake", 0.2),
        ('{kind="kill_process",vehicle="sat1",at_s=2.03}', "vehicle_silent", "", 1.6),
        ('{kind="leak",vehicle="sat1",at_s=2.03,value=0.2}', "leak", "brake", 0.3),
        ('{kind="regulator",vehicle="sat1",at_s=2.03}', "supply_high", "brake", 0.4),
        ('{kind="sag",vehicle="sat1",at_s=2.03}', "supply_low", "brake", 0.3),
        (
            '{kind="overrun",vehicle="sat1",event="faster_than",threshold=0.001}',
            "overrun", "brake", 0.4,
        ),
    ],
)  # fmt: skip
def test_an_injected_fault_is_named_and_answered(inject, named, response, within):
    found = flown("hold", inject, 9.0)
    assert found.early == ()
    assert found.named.startswith(named)
    assert found.detected_s <= within
    assert found.response.words == response
    assert (found.contacts, found.late) == (0, 0)
    # a dead vehicle is landed by its board
    assert found.at_rest_s is not None
    assert found.air == "off"


@pytest.mark.parametrize("row", ["lose_link", "delay_link", "roaming"])
def test_a_lost_link_is_not_called_the_silence_of_others(row):
    what = replace(load(find("hold"), [LOST]).inject[0], vehicle="sat2")
    flight = load(find("zhang2023_table"), ["duration_s=6", "seed=1"])
    found = fly_case(replace(flight, inject=[what]), what, row)
    assert (found.called, found.rightly) == ("link_lost", True)
    silent = FaultReport("neighbour_silent", "", "sat2")
    assert called(silent, [], CATALOGUE[row].names)[2] is False


def test_an_obstacle_that_runs_into_a_vehicle_at_rest_is_no_fault_of_the_response():
    inject = '{kind="drop_mocap",vehicle="sat3",at_s=5.8}'
    found = flown("xue2021_table_dynamic", inject, 15.0)
    assert found.response.words == "brake"
    assert (found.contacts, found.adrift) == (0, 2)  # it pushes the vehicle on


KINDS = 19  # in the drills that these cases are of


@pytest.mark.parametrize(
    ("number", "kind"),
    [
        (22, "noisy_mocap"), (98, "noisy_mocap"), (668, "noisy_mocap"),  # believed to be shoves
        (343, "freeze_mocap"),  # believed to be a wall
        (341, "overrun"),  # stopped 2 cm from the edge, and slid
        (969, "drop_mocap"),  # shut in mid-brake
    ],
)  # fmt: skip
def test_what_once_ended_in_a_contact_does_not_any_more(number, kind):
    found = drawn(kind, EXPERIMENTS[number // KINDS % 2], np.random.default_rng([0, number]))
    assert found.response.words == "brake"
    assert found.detected_s < (0.6 if kind == "drop_mocap" else 0.3)
    assert found.at_rest_s < 0.5
    assert found.air == "off"
    assert (found.contacts, found.late) == (0, 0)
