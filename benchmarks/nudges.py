"""Is a nudge called a nudge, and not a wrong thrust or a bad jet? On the twin.

    python benchmarks/nudges.py [--flights 40] [--seed 5] [--jobs 1]

The velocity of a vehicle jumps by 10 to 40 mm/s in a drawn direction after 3 to 9 s, in flights of
one vehicle that moves a metre and turns a radian, and of zhang2023's three vehicles. Right is a
flight that `bumped` ends, or that no fault ends and whose first row is `nudged`.
"""

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np

from testbed.config import find, load
from testbed.faults.drill import ROUTINE, called
from testbed.rig.twin import make_twin
from testbed.run.drill import Notes

METRE = ["vehicles.sat1.start=[-0.5,-0.5,0.0]", "vehicles.sat1.goal=[0.5,0.5,1.0]"]
EXPERIMENTS = (("hold", METRE), ("zhang2023_table", []))
SIZES = (0.01, 0.04)  # [m/s]
WHEN = (3.0, 9.0)  # [s]
RIGHT = ("bumped", "nudged")


class Hand(Notes):
    """Notes what is said, and pushes the first vehicle once."""

    def __init__(self, at, push):
        super().__init__()
        self.at, self.push, self.twin = at, push, None

    def done(self, t):
        """Push."""
        if self.push is not None and t >= self.at:
            self.twin.plant.x[0, 3:5] += self.push
            self.push = None


def fly(number, seed):
    """Whether a nudge was named right, and what was said."""
    rng = np.random.default_rng([seed, number])
    size = float(np.exp(rng.uniform(*np.log(SIZES))))
    at, way = float(rng.uniform(*WHEN)), float(rng.uniform(-np.pi, np.pi))
    shipped, overrides = EXPERIMENTS[number % len(EXPERIMENTS)]
    experiment = load(find(shipped), [*overrides, f"seed={1000 + number}", "duration_s=30"])
    hand, rig = Hand(at, size * np.array([np.cos(way), np.sin(way)])), make_twin(experiment)
    hand.twin = rig.twin
    ending = rig.fly(hand)
    rows = [(t, row) for t, _, row in hand.rows if t >= at and row not in ROUTINE]
    name, words, right = called(ending.fault, rows, RIGHT)
    return bool(right), f"{number}: {1e3 * size:.0f} mm/s: {name or 'nothing'}: {words}"


def main():
    """Fly, print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--flights", type=int, default=40)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    numbers, seeds = range(options.flights), [options.seed] * options.flights
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        found = list(pool.map(fly, numbers, seeds))
    for right, words in found:
        if not right:
            print(words)
    count = sum(right for right, _ in found)
    print(f"{count} of {len(found)} nudges were named right")
    return int(count < len(found))


if __name__ == "__main__":
    sys.exit(main())
