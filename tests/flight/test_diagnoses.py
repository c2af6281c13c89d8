"""What the benchmark of diagnoses flies many times, once each."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    "only",
    [
        "leak 30,half open,regulator",
        "frame shift,frame creep,heading jump",
        "frozen,4 Hz",
        "heading off,late from",
    ],
)
def test_faults_of_a_lab_are_named_right(only):
    done = subprocess.run(
        [sys.executable, "benchmarks/diagnoses.py", "--each", "1", "--only", only],
        cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
