"""The record of the mutants is of this core, complete, and a sample of it is tried again."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from mutants import all_mutants
from mutation import LEAST, NAMES, RECORD, score, state_of_the_core

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
WRITTEN = tomllib.loads(RECORD.read_text())
SURVIVORS = WRITTEN["survivor"]


def test_the_record_is_of_this_core():
    assert WRITTEN["of_core"] == state_of_the_core(), "the core has changed: run `make mutants`"


def test_enough_faults_are_noticed():
    outcomes = {name: WRITTEN[name] for name in ("survived", "killed", "hung")}
    outcomes |= {name: WRITTEN[name] for name in ("same_code", "not_built")}
    assert sum(outcomes.values()) == len(all_mutants())
    assert outcomes["survived"] == len(SURVIVORS)
    assert round(score(outcomes), 1) == WRITTEN["score_percent"]
    assert score(outcomes) >= LEAST


@pytest.mark.parametrize("one", SURVIVORS, ids=lambda one: f"{one['function']}: {one['now'][:40]}")
def test_every_survivor_is_a_fault_of_this_core_and_is_explained(one):
    assert tuple(one[name] for name in NAMES) in {fault.name for fault in all_mutants()}
    assert len(one["why"].split()) >= 4


@pytest.mark.slow
def test_a_sample_of_the_faults_is_noticed_today():
    command = [sys.executable, HERE / "mutation.py", "--every", "100"]
    result = subprocess.run(
        command, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    assert result.returncode == 0, result.stdout + result.stderr
