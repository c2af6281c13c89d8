"""What it brings that mass and thrust follow the gas in flight (`flight.online`).

    python benchmarks/online.py

A vehicle flies a circle and a step, with a part of its tank already empty: once with the numbers of
its file, once with `flight.online`. Means over the seeds.
"""

import argparse

import numpy as np

from testbed.config import SHIPPED, load
from testbed.rig.observers import MetricsObserver
from testbed.rig.twin import make_twin
from testbed.run.judge import measure

PATHS = {
    "circle": ['vehicles.sat1.path={type="circle", radius=0.6, period_s=60}'],
    "square": ['vehicles.sat1.path={type="square", side=0.6, period_s=60}'],
}
VEHICLES = {
    "freeflyer, 0.25 kg of gas": ["freeflyer"],
    "freeflyer, 2.5 kg of gas": ["freeflyer", "vehicles.sat1.model.air.gas=2.5"],
}
LEFT = {"full": 1.0, "a fifth left": 0.2, "supply at 0.8": 0.025}  # of the gas


def flown(overrides, left):
    """Tracking RMS [mm], heading RMS [deg], gas [g]."""
    experiment = load(SHIPPED / "scenarios" / "circle.toml", overrides)
    rig, observer = make_twin(experiment), MetricsObserver(experiment.vehicles)
    rig.twin.plant.used[:] = (1.0 - left) * experiment.vehicles["sat1"].model.air.gas
    ending = rig.fly(observer)
    metrics = measure(rig, observer.aims, ending, 0.0, completed=ending.fault is None)
    own = metrics.vehicles["sat1"]
    return 1e3 * own.track_rms_m, own.heading_rms_deg, own.gas_g, own.valve_pulses


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    seeds = range(parser.parse_args().seeds)
    for vehicle, (model, *gas) in VEHICLES.items():
        for way, path in PATHS.items():
            for tank, left in LEFT.items():
                words = []
                for on in ("false", "true"):
                    common = [
                        f"vehicles.sat1.model={SHIPPED / 'vehicles' / model}.toml", *gas, *path,
                        "vehicles.sat1.model.tolerance.mass=0", "duration_s=65",
                        f"flight.online.mass={on}", f"flight.online.thrust={on}",
                    ]  # fmt: skip
                    found = np.array([flown([*common, f"seed={seed}"], left) for seed in seeds])
                    mm, deg, grams, pulses = found.mean(axis=0)
                    words.append(f"{mm:.2f} mm, {deg:.3f} deg, {grams:.1f} g, {pulses:.0f} pulses")
                print(f"{vehicle}, {way}, {tank}: {words[0]}; followed: {words[1]}", flush=True)


if __name__ == "__main__":
    main()
