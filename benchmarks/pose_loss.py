"""A vehicle's pose is lost at a random instant of the shipped table experiments.

    python benchmarks/pose_loss.py [--seeds 100] [--jobs 2]

Prints the cases that went wrong, then how many contacts there were (with the table's edge, too),
how soon the loss was named, and how far any vehicle still got.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
from msgspec.structs import replace

from testbed.core.fault_injection import Injection
from testbed.faults.drill import Drilled
from testbed.run.drill import fly_case, shipped

TABLE = (
    "zhang2023_table", "zhang2023_table_wrench", "zhang2023_table_smc", "gao2022_table",
    "xue2021_table_static", "xue2021_table_dynamic", "xue2022_table", "xue2022_table_obstacle",
    "xue2024_table_constant", "xue2024_table_varying",
)  # fmt: skip
AFTER_S = 10.0  # flown on after the loss, or until all vehicles are at rest
NAMED_WITHIN = 0.15  # [s]


def case(seed: int) -> Drilled:
    """Lose one vehicle's pose for good, at a random time of one of the experiments."""
    rng = np.random.default_rng(seed)
    experiment = shipped(TABLE[seed % len(TABLE)])
    at_s = round(float(rng.uniform(0.5, experiment.end_s)), 4)
    loss = Injection("drop_mocap", str(rng.choice(list(experiment.vehicles))), at_s=at_s)
    until = at_s + AFTER_S
    return fly_case(replace(experiment, seed=seed, duration_s=until, inject=[loss]), loss)


def main() -> None:
    """Fly, print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=2)
    options = parser.parse_args()
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        cases = list(pool.map(case, range(options.seeds)))
    for one in cases:
        if one.contacts or one.late or one.detected_s is None or one.detected_s > NAMED_WITHIN:
            print(one)
    named = [one.detected_s for one in cases if one.detected_s is not None]
    print(
        f"{len(cases)} losses of a pose in {len({one.experiment for one in cases})} experiments: "
        f"{sum(one.contacts for one in cases)} contacts (and {sum(one.adrift for one in cases)} of "
        f"an obstacle with a vehicle at rest), {len(named)} named, after "
        f"{np.median(named):.3f} s, at most {max(named):.3f} s; {sum(one.late for one in cases)} "
        f"valves open late; travelled at most {max(one.travelled_m for one in cases):.2f} m"
    )


if __name__ == "__main__":
    main()
