"""A fault in words: the culprit first, each sentence once."""

import pytest

from testbed.config import find, load
from testbed.core.types import Health, ValveCommand
from testbed.logs.feed import SeenInputs, SeenOutputs, SeenTick
from testbed.report.fault_story import SHORT, SUPERVISOR, Said, Story, Trouble, follows, short

SCENARIO = load(find("zhang2023_table"))
STUCK = "valve_stuck_open_push: valve stuck open? pushed by 0.045 m/s^2 that no command explains"
OTHERS = f"fleet: stopped with the others: sat3: {STUCK}"


def tick(t: float, fault: str | None = None, response: str = "", shut: str | None = None):
    command = ValveCommand(0, t, t + 0.1, (0,) * 8, (0,) * 8)
    outputs = SeenOutputs(t, None, None, command, inhibit_reason=shut, fault=fault,
                          response=response)  # fmt: skip
    return SeenTick(SeenInputs(t, True, Health(t, 5e5, 2e7)), outputs)


def test_only_a_fault_of_another_is_followed():
    assert follows(SCENARIO, OTHERS)
    assert not follows(SCENARIO, STUCK)
    assert not follows(SCENARIO, "an older row: and its words")


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (STUCK, "valve stuck open?"),
        ("valve_stuck_closed: valve stuck closed? jet 3 gives no thrust (4.3 sigma)",
         "valve stuck closed? jet 3 gives no thrust"),
        ("pose_lost: pose lost: no pose for 0.52 s", "pose lost"),
        ("mine: " + "many words " * 20, "many words many words many words many words ..."),
        ("without a row", "without a row"),
        ("too fast: (0.30, 0.01) m/s, 0.02 rad/s", "too fast"),
    ],
)  # fmt: skip
def test_a_fault_in_short(fault, words):
    assert short(fault) == words


def test_every_shipped_fault_is_short():
    for name, row in SCENARIO.faults.items():
        said = short(f"{name}: {row.text.format(value=1.0, said='sat2')}")
        assert 0 < len(said) <= SHORT + 4, said


def test_the_banner_names_the_culprit_first():
    trouble = Trouble(SCENARIO)
    trouble.see({"sat1": tick(1.0), "sat2": tick(1.0), "sat3": tick(1.0, STUCK, "land", STUCK)})
    newest = {
        "sat1": tick(1.1, OTHERS, "brake"), "sat2": tick(1.1, OTHERS, "brake", "fleet: stopped"),
        "sat3": tick(1.1, STUCK, "land", STUCK),
    }  # fmt: skip
    trouble.see(newest)
    assert trouble.culprits(newest) == {"sat3": "valve stuck open?"}
    assert trouble.banner(newest) == (
        "FAULT sat3: valve stuck open? - landed   |   sat1 braking too   |   sat2 stopped too"
    )


def test_who_cannot_speak_is_named_by_the_others():
    said = "fleet: stopped with the others: sat2: vehicle_silent: nothing heard for 0.52 s"
    newest = {"sat1": tick(1.0, said, "brake"), "sat2": tick(0.4), "sat3": tick(1.0, said, "brake")}
    trouble = Trouble(SCENARIO)
    trouble.see(newest)
    assert trouble.banner(newest).startswith("FAULT sat2: nothing heard for 0.52 s - silent   |")


def test_no_fault_no_banner():
    newest = {"sat1": tick(1.0), "sat2": tick(1.0, None, "hold")}
    trouble = Trouble(SCENARIO)
    trouble.see(newest)
    assert (trouble.banner(newest), trouble.culprits(newest)) == ("", {})


def test_one_sentence_once():
    rows = [
        (2.1, "sat1", "brake: fleet"), (2.1, "sat1", f"fault: {OTHERS}"),
        (2.1, "sat2", "brake: fleet"), (2.1, "sat2", f"fault: {OTHERS}"),
        (2.0, "sat3", f"valves shut: {STUCK}"), (2.0, "sat3", "land: valve_stuck_open_push"),
        (2.0, "sat3", f"fault: {STUCK}"), (2.2, "sat3", "land: pose_stale, fleet"),
        (2.8, "sat1", f"valves shut: {OTHERS}"), (2.9, SUPERVISOR, f"FAULT: sat3: {STUCK}"),
    ]  # fmt: skip
    lines = Story(SCENARIO).tell(rows)
    assert lines == [
        Said(2.0, ("sat3",), "CRITICAL", f"fault: {STUCK}"),
        Said(2.0, ("sat3",), "ERROR", "valves shut"),
        Said(2.0, ("sat3",), "ERROR", "land: valve_stuck_open_push"),
        Said(2.1, ("sat1", "sat2"), "ERROR", "stopping with the others"),
        Said(2.2, ("sat3",), "ERROR", "land: pose_stale"),
        Said(2.8, ("sat1",), "ERROR", "valves shut"),
        Said(2.9, (SUPERVISOR,), "CRITICAL", "FAULT: sat3"),
    ]
    assert sum(STUCK in line.words for line in lines) == 1


def test_a_fault_that_only_followers_tell_is_told_once():
    said = "fault: fleet: stopped with the others: sat2: law on the host: ValueError"
    rows = [(1.0, "sat1", said), (1.0, "sat3", said)]
    assert [line.who for line in Story(SCENARIO).tell(rows)] == [("sat1",), ("sat3",)]
    words = [line.words for line in Story(SCENARIO).tell(rows)]
    assert words == [said, "stopping with the others"]
