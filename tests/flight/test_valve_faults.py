"""What the benchmark flies many times, a few times: healthy vehicles and valves that fail."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ("kind", "count"), [("slow", 9), ("odd", 1), ("open", 1), ("leaks", 6), ("shut", 2)]
)
def test_healthy_vehicles_fly_on_and_valves_are_named_right(kind, count):
    done = subprocess.run(
        [sys.executable, "benchmarks/valve_faults.py", f"--{kind}", str(count)],
        cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "flights" in done.stdout
