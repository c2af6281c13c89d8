"""zhang2023_table_wrench on the rough table: how many flights meet the criteria, what they cost.

python benchmarks/rough_table.py [--seeds 100] [--jobs 2]
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np

from testbed.config import find, load
from testbed.rig.observers import MetricsObserver
from testbed.rig.twin import make_twin
from testbed.run.judge import measure


def fly(seed):
    """Fault, contacts, whether the criteria hold, and the figures of the vehicles."""
    experiment = load(find("zhang2023_table_wrench_rough"), [f"seed={seed}"])
    rig, observer = make_twin(experiment), MetricsObserver(experiment.vehicles)
    ending = rig.fly(observer)
    found = measure(rig, observer.aims, ending, 0.0, completed=ending.fault is None)
    rows = [
        (v.settle_s or np.nan, v.hold_rms_m or np.nan, v.heading_rms_deg or np.nan, v.impulse_ns)
        for v in found.vehicles.values()
    ]
    fault = ending.fault.words if ending.fault else ""
    return seed, fault, len(rig.touches), all((found.criteria or {"": False}).values()), rows


def main():
    """Fly, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    with ProcessPoolExecutor(args.jobs, mp_context=get_context("spawn")) as pool:
        flights = list(pool.map(fly, range(args.seeds)))
    for seed, fault, touches, passed, _ in flights:
        if fault or touches or not passed:
            why = fault or (f"{touches} contacts" if touches else "a criterion failed")
            print(f"seed {seed}: {why}")
    rows = np.array([row for *_, rows in flights for row in rows])
    print(f"{len(flights)} flights: {sum(f[2] for f in flights)} contacts,", end=" ")
    print(f"{sum(bool(f[1]) for f in flights)} faults, {sum(f[3] for f in flights)} passed")
    names = ("settled after [s]", "hold RMS [m]", "heading RMS [deg]", "impulse [N s]")
    for name, column in zip(names, rows.T, strict=True):
        print(f"{name:18} median {np.nanmedian(column):.4g}, worst {np.nanmax(column):.4g}")


if __name__ == "__main__":
    main()
