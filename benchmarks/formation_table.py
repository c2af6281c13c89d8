"""Fly the chains of xue2022 and xue2024 on the twin, seed after seed: did they keep together?

An edge is settled when it stays within 8 cm of its 1.5 m. Results of the twin, not of a table.
"""

import argparse

import numpy as np

from testbed.config import find, load
from testbed.rig import make_twin

TOLERANCE = 0.08  # [m]
NAMES = ("xue2022_table", "xue2024_table_constant")


class Nobody:
    """Watches nothing."""

    def vehicle(self, name, tick):
        pass

    def host(self, name, tick):
        pass

    def done(self, t):
        pass


def fly(name, seed):
    """When both edges had settled [s], longest edge, nearest pair [m], contacts, fault."""
    experiment = load(find(name), [f"seed={seed}"])
    shape = experiment.controller.formation
    rig = make_twin(experiment)
    ending = rig.fly(Nobody())
    track = rig.track()
    p = track.states[:, :, :2]
    names = list(experiment.vehicles)
    edges, pairs = [], []
    for i in range(len(names)):
        for j in range(i + 1, len(names)):
            gap = np.linalg.norm(p[:, i] - p[:, j], axis=1)
            pairs.append(gap)
            if shape.distances[f"{names[i]}-{names[j]}"] < shape.far:
                edges.append((gap, shape.distances[f"{names[i]}-{names[j]}"]))
    off = np.max([abs(gap - wanted) for gap, wanted in edges], axis=0) > TOLERANCE
    settled = track.t[off.nonzero()[0][-1]] if off.any() else 0.0
    longest = max(gap.max() for gap, _ in edges)
    touches = len(rig.twin.plant.touches)
    return settled, longest, np.min(pairs), touches, ending.fault


def main() -> None:
    """Fly, print one line per experiment."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=20)
    options = parser.parse_args()
    print("experiment                settled median / p95 / max   longest edge  nearest  bad runs")
    for name in NAMES:
        runs = [fly(name, seed) for seed in range(options.seeds)]
        settled, longest, nearest = (np.array([run[k] for run in runs]) for k in range(3))
        bad = sum(bool(run[3]) or run[4] is not None for run in runs)
        print(
            f"{name:24}  {np.median(settled):6.1f} / {np.percentile(settled, 95):5.1f} / "
            f"{settled.max():5.1f} s       {longest.max():8.3f} m  {nearest.min():5.3f} m"
            f"  {bad} of {len(runs)}"
        )


if __name__ == "__main__":
    main()
