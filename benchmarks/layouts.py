"""Clearance of laws in shifted layouts: SOTSMC with and without standoff, MPC.

    python benchmarks/layouts.py [--runs 300] [--shift 0.3] [--laws sotsmc,standoff,mpc]

Obstacles and goals of zhang2023's table experiment are moved at random; starts and goals stay at
least 0.9 m from obstacle centres. No vehicle, no noise: the law on a double integrator.
"""

import argparse

import numpy as np

from controllers.catalogue import make_law
from controllers.mpc import MpcParams
from controllers.potential import PotentialParams
from controllers.scale import Scale
from controllers.sotsmc import SotsmcParams
from testbed.config import find, load
from testbed.core.law import Body, Discs, Goal, World, silent

DURATION, PERIOD, STEPS = 150.0, 0.1, 100
SCALE = Scale(length=62.5, time=10.0, mass=1.0)
LAWS = {
    "sotsmc": SotsmcParams(potential=PotentialParams(standoff=0.0), scale=SCALE),
    "standoff": SotsmcParams(potential=PotentialParams(standoff=2.5), scale=SCALE),
    "mpc": MpcParams(),
}
MASS, MAX_FORCE = 12.5, 0.72  # as the shipped vehicle and guidance have them


def fly(law, start, goal, obstacles, radius):
    """Smallest clearance [m] and when the error is below 0.05 m for good [s]."""
    zero = np.zeros(2)
    world = World(Goal(goal, zero, zero, zero), Discs(obstacles, 0.0 * obstacles, radius))
    no_neighbours = silent(Discs(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0)))
    p, v = start, zero
    state = law.initial(Body(p, v, MASS, zero, zero, MAX_FORCE), no_neighbours, world)
    nearest, settled = np.inf, 0.0
    for k in range(round(DURATION / PERIOD)):
        body = Body(p, v, MASS, zero, zero, MAX_FORCE)
        state, p, v, *_ = law.propagate(
            state, body, no_neighbours, world, k * PERIOD, PERIOD, STEPS
        )
        nearest = min(nearest, np.hypot(*(obstacles - p).T).min())
        if np.hypot(*(goal - p)) > 0.05:
            settled = (k + 1) * PERIOD
    return nearest, settled


def main() -> None:
    """Draw layouts, fly, print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int, default=300)
    parser.add_argument("--shift", type=float, default=0.3)
    parser.add_argument("--laws", default=",".join(LAWS))
    options = parser.parse_args()
    shipped = load(find("zhang2023_table"))
    radius = np.array([obstacle.radius for obstacle in shipped.obstacles.values()])
    for name in options.laws.split(","):
        law = make_law(LAWS[name])
        rng = np.random.default_rng(1)
        rows = []
        while len(rows) < options.runs:
            obstacles = np.array([obstacle.position for obstacle in shipped.obstacles.values()])
            obstacles = obstacles + rng.uniform(-options.shift, options.shift, obstacles.shape)
            for setup in shipped.vehicles.values():
                start = np.array(setup.start[:2])
                goal = np.array(setup.goal[:2]) + rng.uniform(-options.shift, options.shift, 2)
                goal = goal.clip(-2.7, 2.7)
                if min(np.hypot(*(obstacles - p).T).min() for p in (start, goal)) >= 0.9:
                    rows.append(fly(law, start, goal, obstacles, radius))
        nearest, settled = np.array(rows).T
        print(
            f"{name}: {len(rows)} runs, worst clearance {nearest.min():.4f} m, "
            f"below 0.80 m: {np.mean(nearest < 0.80):.1%}, slowest {settled.max():.1f} s"
        )


if __name__ == "__main__":
    main()
