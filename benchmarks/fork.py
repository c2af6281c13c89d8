"""Is a fork without changes the original to the end, and what does flying again cost?

    python benchmarks/fork.py [--ticks 100] [--seed 0]

Five experiments fly with a log; then they are forked at random ticks, as many of each. Every row of
every tick, and the true states, are compared.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

import testbed
from testbed.logs.log_reader import LogReader
from testbed.run.fork import TICKS, departure

EXPERIMENTS = (
    ("hold",), ("zhang2023_table",), ("zhang2023_table_wrench",), ("xue2022_table",),
    ("gao2022_table",),
)  # fmt: skip


def rows(folder: Path) -> list[tuple[str, int, bytes]]:
    """All ticks and truths of a log."""
    kept = (*TICKS, "truth")
    return [row for row in LogReader(folder / "log.mcap").read()
            if row.topic.rpartition("/")[2] in kept]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ticks", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--duration", type=float, default=60.0, help="of each flight [s]")
    given = parser.parse_args()
    rng, wrong = np.random.default_rng(given.seed), 0
    share = given.ticks // len(EXPERIMENTS)
    print(f"{'experiment':26} {'forks':>5} {'equal':>5} {'flight [s]':>10} {'fork [s]':>9}"
          f" {'compare [s]':>11}")  # fmt: skip
    for name, *more in EXPERIMENTS:
        experiment = testbed.load(name, f"duration_s={given.duration}", "criteria={}", *more)
        testbed.fly(experiment)  # compiles
        with tempfile.TemporaryDirectory() as place:
            began = time.perf_counter()
            run = testbed.fly(experiment, log=Path(place, "original"))
            flight = time.perf_counter() - began
            wanted, equal, took, compared = rows(run.folder), 0, [], []
            for k in rng.integers(0, experiment.ticks, share).tolist():
                t = k * experiment.flight.jet_period_s
                began = time.perf_counter()
                fork = run.fork(t, log=Path(place, "fork", str(len(took))))
                took.append(time.perf_counter() - began)
                began = time.perf_counter()
                on_board = experiment.deploy.law == "vehicle"
                assert departure(run.folder, fork.folder, t, on_board=on_board) is None
                compared.append(time.perf_counter() - began)
                equal += rows(fork.folder) == wanted
            wrong += share - equal
            print(f"{name:26} {share:5} {equal:5} {flight:10.2f} {np.median(took):9.2f}"
                  f" {np.median(compared):11.2f}", flush=True)  # fmt: skip
    print("all equal to the end" if not wrong else f"{wrong} forks differ")


if __name__ == "__main__":
    main()
