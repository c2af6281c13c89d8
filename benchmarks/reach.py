"""Does a lab's vehicle reach a goal with the default gains? (1 m, 1 m, 1 rad) within 0.1 in 15 s.

    python benchmarks/reach.py [--seeds 20] [--first 0] [VEHICLE ...]

Flies the shipped vehicle files on the twin with a `pd` law of which nothing is configured, and
counts flights that are within 0.1 m and 0.1 rad from the 15th second to the end. The limits are
those of freeflyer2's own test.
"""

import argparse
import sys

import numpy as np
from msgspec.structs import replace

from testbed.config import SHIPPED, Experiment, loads
from testbed.core.se2 import wrap
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin

VEHICLES = ("freeflyer", "atmos", "uky", "spot_red")
NEAR, SOON_S, LASTS_S = 0.1, 15.0, 25.0  # [m and rad]

TEXT = """
name = "reach"
duration_s = {lasts}
table = "{shipped}/tables/marble_6m.toml"
controller = {{ type = "pd" }}

[vehicles.sat1]
model = "{shipped}/vehicles/{name}.toml"
start = [-0.5, -0.5, 0.0]
goal = [0.5, 0.5, 1.0]
"""


def reach(name: str) -> Experiment:
    """The step of one vehicle."""
    return loads(TEXT.format(name=name, shipped=SHIPPED, lasts=LASTS_S))


def settled_s(experiment: Experiment, seed: int) -> float:
    """Time after which a flight stays near the goal; infinite if it does not [s]."""
    rig = make_twin(replace(experiment, seed=seed))
    if rig.fly(NullObserver()).fault is not None:
        return float("inf")
    track, goal = rig.track(), experiment.vehicles["sat1"].goal
    own = track.states[:, 0]
    off = np.hypot(own[:, 0] - goal[0], own[:, 1] - goal[1])
    turned = np.abs([wrap(theta - goal[2]) for theta in own[:, 2]])
    away = track.t[np.maximum(off, turned) > NEAR]
    return float(away[-1]) if away[-1] < track.t[-1] - 1.0 else float("inf")


def main() -> int:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("vehicles", nargs="*", default=VEHICLES)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    good = True
    for name in options.vehicles:
        experiment = reach(name)
        seeds = range(options.first, options.first + options.seeds)
        times = [settled_s(experiment, seed) for seed in seeds]
        kept = sum(t <= SOON_S for t in times)
        good &= kept == len(times)
        print(
            f"{name:10} {kept} of {len(times)} within {SOON_S:g} s;"
            f" median {np.median(times):.1f} s, last {max(times):.1f} s"
        )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
