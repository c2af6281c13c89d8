"""Fly the formations of xue2021, xue2022, xue2024 on the twin, seed after seed.

    python benchmarks/formation_table.py [--seeds 0:100] [--as-printed] [experiment ...]

Did they keep together, apart and out of the obstacle's way? An edge is lost when it becomes as long
as the law's range; edges are settled when all of E(0) stay within 5 cm (8 cm) of what they should
be. Results of the twin, not of a table.

`--as-printed` is for xue2021_table_static: the paper's own start, 1/48 of it. All drift towards the
obstacle, as in the paper. Vehicles on a table cannot be started like that, so no
experiment file can ask for it.
"""

import argparse
from typing import NamedTuple

import numpy as np

from controllers.graph import formation
from testbed.config import find, load
from testbed.core.codes import FaultReport
from testbed.metrics.run_metrics import obstacle_distances
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin

TOLERANCES = (0.05, 0.08)  # [m]
NAMES = (
    "xue2021_table_static", "xue2021_table_dynamic", "xue2022_table", "xue2022_table_obstacle",
    "xue2024_table_constant", "xue2024_table_varying",
)  # fmt: skip
# Table 2 over 48 [m]; arming requires vehicles at rest. The estimator does not know of the initial
# velocity and suspects jets that give nothing, or too much (13 and 1 of 100 seeds, in 4 s).
AS_PRINTED = (
    "obstacles.o1.position=[1.25,0.0]", "arming.at_rest=0.2",
    "faults.valve_stuck_closed.above=1e9", "faults.valve_stuck_open.above=1e9",
    "faults.valve_leaks.above=1e9", "faults.valve_leaks_or_weak.above=1e9",
)  # fmt: skip
DRIFT = 0.1  # towards the obstacle; its 2 m/s, 0.247 m/s here, would not stop before it [m/s]
LED = ("bounded_leader", "bounded_leader_varying")


class Flight(NamedTuple):
    """Result of a run."""

    settled: tuple  # per tolerance [s]; inf: not
    lost: int  # edges of E(0) that became too long
    longest: float  # edge [m]
    nearest: float  # pair [m]
    obstacle: float  # nearest, centre to centre [m]
    contacts: int
    fault: FaultReport | None


def settling(t, off):
    """When `off` ends for good [s]."""
    if off[-1]:
        return np.inf
    return float(t[off.nonzero()[0][-1]]) if off.any() else 0.0


def fly(name, seed, overrides=(), drift=0.0):
    """Fly once; all vehicles start with the velocity `drift` along x."""
    experiment = load(find(name), [*overrides, f"seed={seed}"])
    names, controller = list(experiment.vehicles), experiment.controller
    led = type(controller).__struct_config__.tag in LED
    shape = formation(controller.formation, names, led)
    rig = make_twin(experiment)
    rig.twin.plant.x[:, 3] = drift
    ending = rig.fly(NullObserver())
    track, n = rig.track(), len(names)
    p = track.states[:, :, :2]
    gaps = {
        (i, j): np.linalg.norm(p[:, i] - p[:, j], axis=1) for i in range(n) for j in range(i + 1, n)
    }
    edges = {pair: gap for pair, gap in gaps.items() if shape.first[pair] > 0.0}
    off = np.max([abs(gap - shape.desired[pair]) for pair, gap in edges.items()], axis=0)
    obstacles = experiment.obstacles
    return Flight(
        tuple(settling(track.t, off > tolerance) for tolerance in TOLERANCES),
        sum(bool((gap >= shape.range).any()) for gap in edges.values()),
        float(max(gap.max() for gap in edges.values())),
        float(min(gap.min() for gap in gaps.values())),
        min(
            (min(obstacle_distances(track, k, obstacles).values()) for k in range(n)),
            default=np.inf,
        )
        if obstacles
        else np.inf,
        len(rig.twin.plant.touches),
        ending.fault,
    )


def main() -> None:
    """Fly, print one line per experiment."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", default="0:20", help="lo:hi, hi not included")
    parser.add_argument("names", nargs="*", default=NAMES, metavar="experiment")
    parser.add_argument("--as-printed", action="store_true", help="with the paper's own start")
    options = parser.parse_args()
    start = (AS_PRINTED, DRIFT) if options.as_printed else ((), 0.0)
    lo, hi = map(int, options.seeds.split(":"))
    print(
        "| experiment | seeds | contacts | lost edges | faults | settled to 5 cm / 8 cm, median",
        end="",
    )
    print(" (worst) [s] | longest edge [m] | nearest pair [m] | nearest to an obstacle [m] |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name in options.names or NAMES:
        runs = [fly(name, seed, *start) for seed in range(lo, hi)]
        settled = np.array([run.settled for run in runs])
        times = " / ".join(f"{np.median(column):.1f} ({column.max():.1f})" for column in settled.T)
        print(
            f"| `{name}` | {lo}-{hi - 1} | {sum(run.contacts for run in runs)} "
            f"| {sum(run.lost for run in runs)} | {sum(run.fault is not None for run in runs)} "
            f"| {times} | {max(run.longest for run in runs):.3f} "
            f"| {min(run.nearest for run in runs):.3f} "
            f"| {min(run.obstacle for run in runs):.3f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
