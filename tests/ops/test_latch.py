"""A fault is kept for the next run; an orderly end takes it away."""

import pytest

from testbed.ops.latch import KILLED, Latch


@pytest.fixture(autouse=True)
def state(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return tmp_path / "airbearing-testbed"


def test_at_first_there_is_nothing():
    assert Latch("table", "lab", "run 1").fault is None


def test_a_fault_is_there_for_the_next_run_and_says_of_which():
    Latch("table", "lab", "run 1").set("sat1: pose_lost")
    assert Latch("table", "lab", "run 2").fault == "run 1: sat1: pose_lost"


def test_a_host_that_is_killed_leaves_it_behind():
    Latch("table", "lab", "run 1").set()  # before the first valve may open
    assert Latch("table", "lab", "run 2").fault == f"run 1: {KILLED}"


def test_an_orderly_end_takes_it_away():
    latch = Latch("table", "lab", "run 1")
    latch.set()
    latch.clear()
    latch.clear()  # once more harms nobody
    assert Latch("table", "lab", "run 2").fault is None


def test_every_lab_and_rig_has_its_own():
    Latch("table", "lab", "run 1").set("sat1: pose_lost")
    assert Latch("bench", "lab", "run 2").fault is None
    assert Latch("table", "other", "run 2").fault is None


def test_what_cannot_be_read_is_no_green_light(state):
    state.mkdir()
    (state / "table-lab.json").write_text("{")
    assert "cannot be read" in Latch("table", "lab", "run 1").fault
