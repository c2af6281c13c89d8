"""The gate's own tests run every line and every branch of it; `make gate` shows it."""

import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_every_branch_of_the_gate_is_taken_both_ways(tmp_path):
    data, report = tmp_path / "coverage", tmp_path / "report.json"
    coverage = [sys.executable, "-m", "coverage"]
    plain = os.environ | {"NUMBA_DISABLE_JIT": "1"}  # machine code is not seen
    subprocess.run(
        [*coverage, "run", "--branch", "--include=testbed/flight/gate.py", f"--data-file={data}",
         "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/flight/test_gate.py"],
        cwd=ROOT, check=True, capture_output=True, env=plain,
    )  # fmt: skip
    subprocess.run(
        [*coverage, "json", f"--data-file={data}", "-o", report],
        cwd=ROOT, check=True, capture_output=True,
    )  # fmt: skip
    (measured,) = json.loads(report.read_text())["files"].values()
    summary = measured["summary"]
    assert summary["num_branches"] >= 40
    assert summary["missing_branches"] == summary["missing_lines"] == 0
