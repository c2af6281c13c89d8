"""What the benchmark measures many times, a few times: valves close, SAFE is latched, all is gone.

The benchmark asks for 200 ms; a machine that is busy testing may stall for longer, so here it is
only asked whether it happens.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("case", ["agent-stop", "serial-cut", "host-kill", "host-stop-vehicle"])
def test_killed_stopped_cut(case):
    done = subprocess.run(
        [sys.executable, "benchmarks/bench_kills.py", case, "--count", "3", "--limit-ms", "2000"],
        cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
