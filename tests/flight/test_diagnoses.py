"""What the benchmark of diagnoses flies many times, once each."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import testbed

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    "only",
    [
        "leak 30,half open,regulator",
        "frame shift,frame creep,heading jump",
        "frozen,4 Hz",
        "heading off,late from",
        "thrust x1.4,mass x0.5",
    ],
)
def test_faults_of_a_lab_are_named_right(only):
    done = subprocess.run(
        [sys.executable, "benchmarks/diagnoses.py", "--each", "1", "--only", only],
        cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("seed", "words"),
    [
        (101, ["table.mocap.noise=0.001"]),
        (101, ["table.mocap.noise=0.002"]),
        (2, ["flight.jet_period_s=0.5"]),
    ],
)
def test_a_quiet_hold_does_not_look_like_a_wrong_mass(seed, words):
    """Its pushes answer the noise of the estimate, which then comes back by itself."""
    run = testbed.fly(testbed.load("hold", "criteria={}", *words, seed=seed))
    assert run.metrics.fault is None
    assert run.metrics.duration_s == 120.0


@pytest.mark.parametrize(
    ("experiment", "seed", "words"),
    [
        ("hold", 1, ["table.spread.hose_torque=0.003"]),  # was: a jet leaks 8 % of its thrust
        ("hold", 7, ["table.spread.hose_torque=0.01"]),
        ("hold", 3, ["table.spread.hose_torque=0.005", "vehicles.*.model=uky"]),
    ],
)
def test_a_torque_of_a_hose_or_the_bearings_is_no_jet(experiment, seed, words):
    run = testbed.fly(testbed.load(experiment, "criteria={}", "duration_s=40", *words, seed=seed))
    assert run.metrics.fault is None
    assert run.metrics.warnings == []
