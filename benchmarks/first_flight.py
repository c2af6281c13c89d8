"""The first flight on a machine: a command's time with an empty cache of machine code.

    python benchmarks/first_flight.py [--wheel dist/airbearing_testbed-0.1.0-py3-none-any.whl]

From these sources everything is compiled; from a wheel of `make wheel` nothing is. Then the same
again, with what the first one left in the cache.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def flight(tree: Path, home: Path) -> float:
    """Wall time of the command, with the log and report [s]."""
    environment = os.environ | {"PYTHONPATH": str(tree), "XDG_CACHE_HOME": str(home / "cache")}
    environment.pop("NUMBA_CACHE_DIR", None)
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as run:
        subprocess.run(
            [sys.executable, "-m", "testbed", "run", "zhang2023_table", "--out", f"{run}/flight"],
            env=environment, cwd=home, check=True, stdout=subprocess.DEVNULL,
        )  # fmt: skip
    return time.perf_counter() - began


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--wheel", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        if options.wheel is not None:
            zipfile.ZipFile(options.wheel).extractall(home / "site")
        tree = ROOT if options.wheel is None else home / "site"
        for number in ("first", "second"):
            print(f"{number} flight: {flight(tree, home):.1f} s", flush=True)
        kept = [path.name for path in (home / "cache").rglob("*.nbc")]
        print(f"functions compiled: {len(kept)}")


if __name__ == "__main__":
    main()
