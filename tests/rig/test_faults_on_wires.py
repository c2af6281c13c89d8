"""Faults injected where they happen, over real wires: each is named, and every valve is shut.

`testbed drill --rig bench` does the same with three vehicles, again and again.
"""

from pathlib import Path

import msgspec
import pytest

from testbed.cli.result import print_result
from testbed.config import find, load
from testbed.core.codes import FaultId
from testbed.core.fault_injection import Injection
from testbed.metrics.run_metrics import Metrics, ReferenceLog
from testbed.rig.observers import NullObserver
from testbed.rig.twin import warm_up
from testbed.rig.wired.host import WireRig
from testbed.run.judge import measure

AT = 1.0  # [s]


class Noted(NullObserver):
    """Keeps the rows of the fault table that held, in order."""

    def __init__(self):
        self.rows, self.commands = {}, []

    def vehicle(self, name, tick):
        for row in tick.outputs.faults:
            self.rows.setdefault(row, tick.outputs.t)
        self.commands.append((tick.outputs.t, tick.outputs.command.on_us))


def fly(kind, *overrides, value=None, for_s=1e6, duration=4.0):
    words = [f"duration_s={duration}", "deploy.law=vehicle", *overrides]
    experiment = load(find("hold"), words)
    what = Injection(kind, "sat1", at_s=AT, value=value, for_s=for_s)
    warm_up(experiment)
    experiment.inject.append(what)
    rig, noted = WireRig(experiment, bench=True), Noted()
    return rig, rig.fly(noted), noted


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "value", "names"),
    [
        ("operator_gone", None, ["operator_gone"]),
        ("config_differs", None, ["config_differs"]),
        ("disk_full", None, ["disk_full"]),
        ("clock_step", 0.04, ["clock_off"]),
        ("overrun", 0.09, ["overrun", FaultId.BOARD_LEFT_ARMED]),
        ("flat_battery", None, ["battery_low"]),
        ("sag", None, ["supply_low"]),
        ("cut_serial", None, ["board_silent", FaultId.BOARD_LEFT_ARMED]),
        ("brown_out", None, ["board_silent", "battery_low"]),
        ("freeze_mocap", None, ["pose_frozen"]),
    ],
)
def test_a_fault_is_named_and_ends_the_flight(kind, value, names):
    rig, ending, noted = fly(kind, value=value)
    assert ending.fault is not None
    if not ending.fault.vehicle:  # of no vehicle: a busy machine did not run the host in time
        rig, ending, noted = fly(kind, value=value)
    assert ending.fault.vehicle == "sat1", ending.fault
    assert ending.fault.id in names, (ending.fault, noted.rows)
    assert rig.supervisor.phase == "FAULT"
    assert rig.results.report.edges["sat1"][-1][1] == 0
    assert rig.touches == []


@pytest.mark.slow
def test_messages_of_another_session_are_named_and_change_nothing():
    _, ending, noted = fly("foreign_session", "deploy.law=host")
    assert ending.fault is None
    assert "foreign" in noted.rows
    assert "setpoint" not in str(noted.rows)


@pytest.mark.slow
def test_the_law_dies_on_the_host_and_the_vehicle_is_brought_to_rest():
    rig, ending, noted = fly("raise_law", "deploy.law=host")
    assert ending.fault.id == FaultId.HOST_LAW_RAISED
    assert "fleet" in noted.rows  # it was told, and stopped by itself
    assert rig.results.report.edges["sat1"][-1][1] == 0


BUSY = ("board_silent", FaultId.BOARD_LEFT_ARMED)  # by a machine that stops for a quarter second


def fly_undisturbed(*words, **options):
    """The same, again if a busy machine ended the flight before."""
    for _ in range(3):
        flown = fly(*words, **options)
        if flown[1].fault is None or flown[1].fault.id not in BUSY:
            break
    return flown


@pytest.mark.slow
def test_a_board_that_was_reset_is_named_with_the_cause():
    _, ending, _ = fly_undisturbed("brown_out", for_s=0.05)
    assert ending.fault.id == FaultId.BOARD_RESET, ending.fault
    assert "brown-out" in ending.fault.text


@pytest.mark.slow
def test_a_flood_is_named_and_changes_nothing():
    rig, ending, _ = fly_undisturbed("flood", "deploy.law=host")
    assert ending.fault is None
    assert FaultId.FLOODED in rig.results.ended["sat1"].rows
    assert "flooded" in [one.name for one in rig.results.concerns()]


@pytest.mark.slow
def test_a_row_that_warns_is_a_warning_of_the_result(capsys):
    rig, ending, _ = fly_undisturbed("slow_mocap", "criteria={}", duration=5.0)
    assert ending.fault is None
    references = {"sat1": ReferenceLog()}
    metrics = measure(rig, references, ending, 1.0, completed=True)
    (warning,) = (one for one in metrics.warnings if one.name == "pose_rate_low")
    assert warning.text.startswith("sat1: the cameras give")
    assert msgspec.json.decode(msgspec.json.encode(metrics), type=Metrics).warnings
    print_result(metrics, rig.experiment, Path("runs"))
    assert f"warning: pose_rate_low: {warning.text}" in capsys.readouterr().out


FIXED = "table.lab.mocap.reference={north=[0.0,2.9,0.0],east=[2.9,0.0,0.0]}"


@pytest.mark.slow
def test_reference_bodies_show_a_frame_that_creeps():
    _, ending, noted = fly_undisturbed("creep_frame", FIXED, value=0.02)
    assert ending.fault is not None
    assert ending.fault.origin.id == FaultId.FRAME_MOVED, ending.fault
    assert "the cameras' frame moved: north" in ending.fault.words
    assert "fleet" in noted.rows


@pytest.mark.slow
def test_a_frame_that_has_moved_does_not_arm():
    words = ["duration_s=2.0", "deploy.law=vehicle", FIXED]
    experiment = load(find("hold"), words)
    warm_up(experiment)
    experiment.inject.append(Injection("shift_frame", "sat1", at_s=0.0, value=0.02))
    rig = WireRig(experiment, bench=True)
    rig.fly(NullObserver())
    assert [one.id for one in rig.red] == ["frame"]
    assert "the cameras' frame moved" in rig.red[0].reason
