"""What the drill counts against a vehicle is what the vehicle could have known and done."""

import zlib

import numpy as np
import pytest
from msgspec.structs import replace

from testbed.cli.drill import print_drill
from testbed.core.codes import FaultReport, Response
from testbed.faults.catalogue import CATALOGUE
from testbed.faults.drill import Drilled, called, summarise
from testbed.run.drill import EXPERIMENTS, drawn

CREPT = Drilled(
    "frame_creeps", "x", "a", 0, 3.0, "", None, Response.WARN, None, 0, 0, 0.1, None, (), 0,
    dormant=False,
)  # fmt: skip


def swapped(number):
    """A drawn flight in which two vehicles have each other's boards from a time on."""
    kind = "swap_boards"
    rng = np.random.default_rng([0, number, zlib.crc32(kind.encode())])
    return drawn(kind, EXPERIMENTS[number % 2], rng)


def test_the_gate_answers_swapped_boards_but_does_not_name_them():
    found = swapped(0)
    assert (found.called, found.rightly) == ("too_fast", False)
    assert (found.named, found.missed) == ("too_fast", False)
    assert found.detected_s == pytest.approx(3.73, abs=0.1)


def test_poses_that_freeze_and_dither_may_look_like_a_wall():
    rng = np.random.default_rng([3, 48, zlib.crc32(b"dithered_freeze")])
    found = drawn("dithered_freeze", "zhang2023_table", rng)
    assert (found.called, found.rightly, found.response) == ("bumped", False, Response.BRAKE)
    assert (found.named, found.missed) == ("bumped", False)


@pytest.mark.parametrize("number", [3, 18, 20])
def test_a_vehicle_is_not_asked_to_shut_the_valves_of_another(number):
    """It lands, and so the other one's valves are shut; its own obey the other one's brake."""
    found = swapped(number)
    assert (found.response, found.rightly) == (Response.LAND, True)
    assert (found.late, found.contacts) == (0, 0)


def test_a_vehicle_that_another_one_steers_cannot_keep_clear():
    found = swapped(11)
    assert found.contacts == 0
    assert found.adrift > 0


def test_a_frame_that_creeps_and_a_push_are_alike_to_a_vehicle(capsys):
    case = CATALOGUE["frame_creeps"]
    names, alike = case.names, case.alike
    warned = called(None, [(3.4, "nudged")], names, alike)
    assert warned == ("nudged", "a warning", None)
    assert called(None, [(3.4, "frame_moved")], names, alike)[2] is True  # by reference bodies
    assert called(None, [(3.4, "valve_leaks")], names, alike)[2] is False
    assert called(FaultReport("nudged", "x", "a"), [], names, alike)[2] is None
    cases = [replace(CREPT, called=warned[0], said=warned[1], rightly=warned[2])] * 3
    drill = summarise("twin", cases)
    row = drill.rows[0]
    assert (row.alike, row.judged, row.undetected, row.called) == (3, 0, 0, {"nudged": 3})
    print_drill(drill, cases)
    said = capsys.readouterr().out
    assert "named: 0 of 0 answers" in said
    assert "  frame_creeps was called nudged (3): a vehicle cannot tell them apart\n" in said
