"""Time and memory of the repulsion sum for N = 50 ... 50 000.

    python benchmarks/repulsion.py [--runs 7] [--threads 2]

Two layouts: a disk where s is two spacings (13 neighbours each, however many there are), in 2-D and
as a ball in 3-D, and gao2022's ring with s = r, where a third of all satellites sees each other and
no structure helps. Best of several runs; "one core" is processor time of the same sum without
threads, which a busy machine disturbs less than it disturbs wall time.
"""

import argparse
import os
import time
import tracemalloc
from collections.abc import Callable

import numba
import numpy as np
from numpy.typing import NDArray

from controllers.repulsion import pairs, repulsion, rows
from controllers.repulsion_cells import cells

Array = NDArray[np.float64]

COUNTS = (50, 500, 5000, 50_000)
STIFFNESS = 1.0  # [N/m]


def disk(count: int) -> tuple[Array, float]:
    """Even at random; s is two spacings, a spacing the root of the area per satellite."""
    rng = np.random.default_rng(count)
    r, angle = np.sqrt(rng.uniform(size=count)), rng.uniform(0.0, 2.0 * np.pi, count)
    return np.c_[r * np.cos(angle), r * np.sin(angle)], 2.0 * np.sqrt(np.pi / count)


def ball(count: int) -> tuple[Array, float]:
    """Even at random; s such that 13 neighbours are within it."""
    rng = np.random.default_rng(count)
    x = rng.normal(size=(count, 3))
    x *= (rng.uniform(size=count) ** (1.0 / 3.0) / np.linalg.norm(x, axis=1))[:, None]
    return x, float((13.0 / count) ** (1.0 / 3.0))


def ring(count: int) -> tuple[Array, float]:
    """Evenly spread; s = r."""
    angle = 2.0 * np.pi * np.arange(count) / count
    return np.c_[np.cos(angle), np.sin(angle)], 1.0


def best(runs: int, clock: Callable[[], float], function: Callable[[], object]) -> float:
    """Shortest of several runs [s]."""
    function()
    times = []
    for _ in range(runs):
        began = clock()
        function()
        times.append(clock() - began)
    return min(times)


def measure(layout: Callable[[int], tuple[Array, float]], count: int, runs: int) -> str:
    """A row of the table."""
    x, reach = layout(count)
    force = np.empty_like(x)
    alone = pairs if count <= 500 else rows if layout is ring else cells
    wall = best(runs, time.perf_counter, lambda: repulsion(x, STIFFNESS, reach))
    core = best(runs, time.thread_time, lambda: alone(STIFFNESS, reach, x, force))
    tracemalloc.start()
    repulsion(x, STIFFNESS, reach)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return f"{layout.__name__:6}{count:8}{1e3 * wall:14.4f}{1e3 * core:14.4f}{peak / 1e6:12.2f}"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=7)
    parser.add_argument("--threads", type=int, default=numba.config.NUMBA_NUM_THREADS)
    options = parser.parse_args()
    numba.set_num_threads(options.threads)
    load = os.getloadavg()[0]
    print(f"{options.threads} threads, {os.cpu_count()} cores, load of the machine {load:.2f}")
    print("layout       N     wall [ms] one core [ms] numpy [MB]")
    for layout in (disk, ball, ring):
        for count in COUNTS:
            slow = layout is ring and count > 5000
            print(measure(layout, count, 1 if slow else options.runs))


if __name__ == "__main__":
    main()
