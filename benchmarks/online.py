"""What it brings that mass and thrust follow the gas in flight, and jets what they give.

    python benchmarks/online.py

The freeflyer flies a circle and a square, with a part of its tank already empty: with the numbers
of its file, with the mass that follows the gas, and with the thrust as well. Then with one jet that
gives a part of its thrust, another one per seed: without and with `flight.online.jets`. Means over
the seeds.
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
CASES = {  # overrides of the freeflyer, and the part of the gas that is left
    "0.25 kg of gas, full tank": ([], 1.0),
    "0.25 kg of gas, a fifth left": ([], 0.2),
    "2.5 kg of gas, a fifth left": (["gas=2.5"], 0.2),
    "2.5 kg of gas at 0.8 MPa, supply at 0.8": (["gas=2.5", "tank_pressure=0.8e6"], 0.625),
}
MODES = {"file": (), "mass": ("mass",), "both": ("mass", "thrust")}


WEAK = (0.7, 0.85, 1.0)  # share of its thrust that one jet gives


def flown(overrides, left=1.0):
    """Tracking RMS [mm], heading RMS [deg], 1 if the flight was completed."""
    experiment = load(SHIPPED / "scenarios" / "circle.toml", overrides)
    rig, observer = make_twin(experiment), MetricsObserver(experiment.vehicles)
    rig.twin.plant.used[:] = (1.0 - left) * experiment.vehicles["sat1"].model.air.gas
    ending = rig.fly(observer)
    metrics = measure(rig, observer.aims, ending, 0.0, completed=ending.fault is None)
    own = metrics.vehicles["sat1"]
    return 1e3 * own.track_rms_m, own.heading_rms_deg, float(ending.fault is None)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--only", choices=["gas", "jets"])
    asked = parser.parse_args()
    seeds = range(asked.seeds)
    for what, (air, left) in CASES.items() if asked.only != "jets" else ():
        for way, path in PATHS.items():
            words = []
            for mode, switches in MODES.items():
                overrides = [
                    f"vehicles.sat1.model={SHIPPED / 'vehicles' / 'freeflyer.toml'}", *path,
                    *(f"vehicles.sat1.model.air.{one}" for one in air),
                    "vehicles.sat1.model.tolerance.mass=0", "duration_s=65",
                    *(f"flight.online.{one}=true" for one in switches),
                ]  # fmt: skip
                found = np.array([flown([*overrides, f"seed={seed}"], left) for seed in seeds])
                mm, deg, done = found.mean(axis=0)
                words.append(f"{mode} {mm:.2f} mm, {deg:.3f} deg{'' if done == 1 else ' (aborts)'}")
            print(f"{what}, {way}: {'; '.join(words)}", flush=True)
    for share in WEAK if asked.only != "gas" else ():
        for way, path in PATHS.items():
            words = []
            for switch in ("false", "true"):
                common = [
                    f"vehicles.sat1.model={SHIPPED / 'vehicles' / 'freeflyer.toml'}", *path,
                    "duration_s=185", f"flight.online.jets={switch}",
                ]  # fmt: skip
                found = np.array([
                    flown([*common, f"seed={seed}", f"inject=[{weak(1 + seed % 8, share)}]"])
                    for seed in seeds
                ])  # fmt: skip
                mm, deg, done = found.mean(axis=0)
                text = f"{mm:.2f} mm, {deg:.3f} deg{'' if done == 1 else ' (aborts)'}"
                words.append(f"{'jets' if switch == 'true' else 'file'} {text}")
            print(f"one jet at {share:.0%}, {way}: {'; '.join(words)}", flush=True)


def weak(jet, share):
    """The injection of a weak jet, from the start on."""
    return f'{{kind="weak_jet", vehicle="sat1", jet={jet}, at_s=0, for_s=1e6, value={share}}}'


if __name__ == "__main__":
    main()
