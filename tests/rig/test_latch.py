"""A fault is kept for the next run; an orderly end takes it away."""

import pytest
from msgspec.structs import replace

from testbed.core.codes import FaultReport
from testbed.rig.fault_latch import KILLED, FaultLatch

LOST = FaultReport("pose_lost", "pose lost", "sat1", "pose_age", 0.6)


@pytest.fixture(autouse=True)
def state(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return tmp_path / "airbearing-testbed"


def test_at_first_there_is_nothing():
    assert FaultLatch("table", "lab", "run 1").fault is None


def test_a_fault_is_there_for_the_next_run_and_says_of_which():
    FaultLatch("table", "lab", "run 1").set(LOST)
    assert FaultLatch("table", "lab", "run 2").fault == replace(LOST, notes=("in run 1",))


def test_a_host_that_is_killed_leaves_it_behind():
    FaultLatch("table", "lab", "run 1").set()  # before the first valve may open
    assert FaultLatch("table", "lab", "run 2").fault == replace(KILLED, notes=("in run 1",))


def test_an_orderly_end_takes_it_away():
    latch = FaultLatch("table", "lab", "run 1")
    latch.set()
    latch.clear()
    latch.clear()  # once more harms nobody
    assert FaultLatch("table", "lab", "run 2").fault is None


def test_every_lab_and_rig_has_its_own():
    FaultLatch("table", "lab", "run 1").set(LOST)
    assert FaultLatch("bench", "lab", "run 2").fault is None
    assert FaultLatch("table", "other", "run 2").fault is None


def test_what_cannot_be_read_is_no_green_light(state):
    state.mkdir()
    for text in ("{", '["run 1", "sat1: pose_lost"]', "\x00", "[" * 10_000):
        (state / "table-lab.json").write_text(text)
        assert "cannot be read" in FaultLatch("table", "lab", "run 1").fault.text
