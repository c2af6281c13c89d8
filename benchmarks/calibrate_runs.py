"""Accuracy of calibration from runs of this project, which are flown in closed loop.

    python benchmarks/calibrate_runs.py [--each 5]

Two paths, cameras with 0.2 and 0.5 mm of noise, and a light vehicle with slow valves. Errors are
those of the numbers that are written; an interval is right if the twin's true number is in it.
"""

import argparse
import tempfile
from pathlib import Path

import testbed
from testbed.config import SHIPPED, load
from testbed.identification.motion import RefusedError, calibrate_motion, interval, thrusts
from testbed.identification.own_run import read_run_log
from testbed.rig.twin import make_twin


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--each", type=int, default=5, help="seeds of each case")
    count = parser.parse_args().each
    slow = ["valve.open_delay_s=0.02", "valve.close_delay_s=0.02", "valve.min_off_s=0.03"]
    light = [f"vehicles.*.model.{word}" for word in ["mass=4.0", "inertia=0.05", *slow]]
    noisy = ["table.mocap.noise=0.0005", "table.mocap.noise_deg=0.1"]
    cases = {
        "step": ("step", []), "step, 0.5 mm": ("step", noisy), "square, 0.5 mm": ("square", noisy),
        "square, 4 kg, 0.5 mm": ("square", [*light, *noisy]),
    }  # fmt: skip
    inside, worst = {}, {}
    for case, (scenario, words) in cases.items():
        for seed in range(count):
            with tempfile.TemporaryDirectory() as folder:
                path = SHIPPED / "scenarios" / f"{scenario}.toml"
                experiment = load(path, [*words, "criteria={}", f"seed={seed + 1}"])
                testbed.fly(experiment, log=Path(folder) / "run")
                log = read_run_log(Path(folder) / "run", None)
            vehicle = experiment.vehicles["sat1"].model
            flown = make_twin(experiment).twin.plant.parameters
            try:
                found = calibrate_motion([log], vehicle)
            except RefusedError as error:
                print(f"  {case}, seed {seed + 1}: refused: {error.found}", flush=True)
                inside.setdefault("not refused", []).append(False)
                continue
            heavier = vehicle.mass / flown.mass[0]  # the fit takes the file's mass
            true = {
                "inertia": heavier * flown.inertia[0] / vehicle.inertia,
                "delay": flown.timing[0, 0],
            }
            errors = {}
            for name, value in true.items():
                i = found.model.index(name)
                low, high = interval(found, i)
                inside.setdefault(name, []).append(low <= value <= high)
                errors[name] = found.estimate.p[i] - value
            for row, thrust in zip(thrusts(found), heavier * flown.thrust[0], strict=True):
                inside.setdefault("thrust", []).append(row["low_n"] <= thrust <= row["high_n"])
                error = row["thrust_n"] / thrust - 1
                errors["thrust"] = max(errors.get("thrust", 0.0), error, key=abs)
            for name, error in errors.items():
                worst.setdefault(name, []).append(abs(error))
            print(f"  {case}, seed {seed + 1}:", {n: float(f"{e:.3g}") for n, e in errors.items()},
                  flush=True)  # fmt: skip
    for name, hits in inside.items():
        far = f", largest error {max(worst[name]):.3g}" if name in worst else ""
        print(f"{name}: inside {sum(hits)} of {len(hits)} intervals{far}")


if __name__ == "__main__":
    main()
