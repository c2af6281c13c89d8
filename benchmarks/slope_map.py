"""A rough table's slope: the map of a table file, with the statistics of a measured plate.

    python benchmarks/slope_map.py --size 4 --seed 1

ITA's glass plate (doctoral thesis, github.com/luanvogas/Design-modeling-and-control-of-a-low-cost-
air-bearing-platform, 13fe8eb), 27 x 27 level readings on 1.3 m x 1.3 m: mean 3 and 5 mm/s^2 along x
and y, standard deviation 9 and 16, largest 36 and 56. Along its own axis the slope has forgotten
itself after 0.45 m; across it, it hardly changes on 1.3 m.

The height of the surface is a sum of waves with random directions and phases, and the map is its
gradient: a ball that is rolled around gains nothing.
"""

import argparse

import numpy as np

NODE = 0.25  # [m] between nodes
BUMP = 0.4  # [m] the height's correlation is exp(-r^2 / 2 BUMP^2)
DEVIATION = 0.012  # of each component [m/s^2]
WAVES = 200


def slope_map(size, seed, deviation=DEVIATION):
    """Accelerations along the surface, shape (rows, columns, 2) [m/s^2]."""
    rng = np.random.default_rng(seed)
    wave = rng.standard_normal((WAVES, 2)) / BUMP  # [rad/m]
    phase = rng.uniform(0.0, 2.0 * np.pi, WAVES)
    y, x = (np.linspace(-0.5 * s, 0.5 * s, round(s / NODE) + 1) for s in reversed(size))
    angle = x[None, :, None] * wave[:, 0] + y[:, None, None] * wave[:, 1] + phase
    gradient = np.sin(angle) @ wave * BUMP * np.sqrt(2.0 / WAVES)
    return deviation * gradient


def lines(grid):
    """The map as TOML."""
    rows = [", ".join(f"[{ax:.4f}, {ay:.4f}]" for ax, ay in row) for row in grid.tolist()]
    return "\n".join(["map = [", *(f"  [{row}]," for row in rows), "]"])


def main():
    """Print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=float, nargs="+", default=[4.0], help="along x and y [m]")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--deviation", type=float, default=DEVIATION, help="[m/s^2]")
    args = parser.parse_args()
    print(lines(slope_map((args.size * 2)[:2], args.seed, args.deviation)))


if __name__ == "__main__":
    main()
