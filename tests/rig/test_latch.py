"""A fault is kept for the next run; an orderly end takes it away."""

import pytest

from testbed.rig.fault_latch import KILLED, FaultLatch


@pytest.fixture(autouse=True)
def state(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return tmp_path / "airbearing-testbed"


def test_at_first_there_is_nothing():
    assert FaultLatch("table", "lab", "run 1").fault is None


def test_a_fault_is_there_for_the_next_run_and_says_of_which():
    FaultLatch("table", "lab", "run 1").set("sat1: pose_lost")
    assert FaultLatch("table", "lab", "run 2").fault == "run 1: sat1: pose_lost"


def test_a_host_that_is_killed_leaves_it_behind():
    FaultLatch("table", "lab", "run 1").set()  # before the first valve may open
    assert FaultLatch("table", "lab", "run 2").fault == f"run 1: {KILLED}"


def test_an_orderly_end_takes_it_away():
    latch = FaultLatch("table", "lab", "run 1")
    latch.set()
    latch.clear()
    latch.clear()  # once more harms nobody
    assert FaultLatch("table", "lab", "run 2").fault is None


def test_every_lab_and_rig_has_its_own():
    FaultLatch("table", "lab", "run 1").set("sat1: pose_lost")
    assert FaultLatch("bench", "lab", "run 2").fault is None
    assert FaultLatch("table", "other", "run 2").fault is None


def test_what_cannot_be_read_is_no_green_light(state):
    state.mkdir()
    (state / "table-lab.json").write_text("{")
    assert "cannot be read" in FaultLatch("table", "lab", "run 1").fault
