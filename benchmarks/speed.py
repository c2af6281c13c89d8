"""How fast the twin is: the reference run, everything on, and what `testbed --help` takes.

    python benchmarks/speed.py [--runs 5]

Ratios to real time, after compilation, log written; and the best of several starts of the command.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from testbed.cli.run import fly_and_judge
from testbed.config import find, load


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=5)
    options = parser.parse_args()
    experiment = load(find("zhang2023_table"))
    factors = []
    for _ in range(options.runs):
        with tempfile.TemporaryDirectory() as folder:
            factors.append(fly_and_judge(experiment, Path(folder)).real_time_factor or 0.0)
    print(f"zhang2023_table, 3 vehicles, 150 s: {min(factors):.0f}-{max(factors):.0f} x real time")
    command = Path(sys.executable).with_name("testbed")
    starts = []
    for _ in range(options.runs):
        began = time.perf_counter()
        subprocess.run([command, "--help"], check=True, stdout=subprocess.DEVNULL)
        starts.append(time.perf_counter() - began)
    print(f"testbed --help: best {1e3 * min(starts):.0f} ms, worst {1e3 * max(starts):.0f} ms")


if __name__ == "__main__":
    main()
