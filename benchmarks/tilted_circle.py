"""The error of ITA's closed loop on its circle, predicted with a slope map and beside the flight's.

    python benchmarks/tilted_circle.py

The lab's law is regressed from the commands of its log. It flies a mass on the map that was learned
from the other logs, or on the measured one, with the camera's queue, noise and the fitted delay.
"""

import argparse
from pathlib import Path

import numpy as np

from sim_twin.ground import lay, tilt_at
from testbed.identification.columns import read_columns
from testbed.identification.floor import learn_floor
from testbed.identification.mapping import load_mapping
from testbed.identification.motion_log import read_motion_log
from testbed.identification.slope_map import measured_map, with_map
from testbed.identification.table_file import load_table
from testbed.identification.vehicle_file import load_vehicle

NODES = "x_m", "y_m", "accel_x_mm_s2", "accel_y_mm_s2"
STEP, PERIOD = 0.005, 0.125  # [s]
CAMERA = 0.05  # [s] latency
NOISE = 1e-3  # [m] of a pose
BEGIN = 40  # rows until the circle
RADIUS = 0.3  # [m]


def pair(columns, stem):
    return np.stack([columns[stem.format(axis)] for axis in "xy"], axis=1)


def law_of(columns):
    """Gains on the error and its last three differences."""
    force = pair(columns, "f{}_cmd_N") - pair(columns, "tilt_comp_f{}_N")
    error = pair(columns, "{}_m") - pair(columns, "ref_{}_m")
    change = np.diff(error, axis=0)
    seen = np.stack([error[3:], change[2:], change[1:-1], change[:-2]], axis=2)
    return np.linalg.lstsq(seen.reshape(-1, 4), force[3:].ravel(), rcond=None)[0]


def figures(path, goal):
    """RMS error and RMS error of the radius [mm]."""
    off, radius = np.hypot(*(path - goal)[BEGIN:].T), np.hypot(*path[BEGIN:].T)
    return tuple(1e3 * float(np.sqrt(np.mean(one**2))) for one in (off, radius - RADIUS))


def flown(ground, told, mass, own_mass, delay, gains, columns, queue):
    """Measured path of the loop; `told` is the map that the law compensates, or None."""
    rng, goal = np.random.default_rng(0), pair(columns, "ref_{}_m")
    x, v = pair(columns, "{}_m")[0], np.zeros(2)
    before = int(0.5 / STEP)
    path, forces, errors, seen = [x] * before, [np.zeros(2)] * before, [], []
    late, age = int(max(0.0, delay - CAMERA) / STEP), 0.0
    for row in range(len(goal)):
        pose = path[-1 - int((CAMERA + age) / STEP)] + NOISE * rng.standard_normal(2)
        age = (age + PERIOD - queue.frame_s) % (queue.frame_s * queue.frames - 1e-9)
        seen.append(pose)
        errors.append(pose - goal[row])
        e = [errors[max(0, row - k)] for k in range(4)]
        force = gains @ np.array([e[0], e[0] - e[1], e[1] - e[2], e[2] - e[3]])
        if told is not None:
            force = force - own_mass * np.array(tilt_at(told, *pose))
        for _ in range(round(PERIOD / STEP)):
            forces.append(force)
            v = v + STEP * (forces[-1 - late] / mass + np.array(tilt_at(ground, *x)))
            x = x + STEP * v
            path.append(x)
    return np.array(seen)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    parser.add_argument("--data", type=Path, default=beside, help="folder of the labs' logs")
    folder = parser.parse_args().data / "ita"
    vehicle, mapping = load_vehicle("ita"), load_mapping("ita")
    measured = lay(measured_map(read_columns(folder / "tilt_map.csv"), NODES, "mm/s^2"))
    logs = {path: read_motion_log(path, mapping) for path in sorted(folder.glob("dl*.csv"))}
    gains = law_of(read_columns(folder / "dlqr_track_uncompensated_no_wheel.csv"))
    print(f"law: {np.round(gains, 3)} N/m on the error and its last three differences")
    for path in logs:
        if "track" not in path.name:
            continue
        columns = read_columns(path)
        floor = learn_floor([log for p, log in logs.items() if p != path], vehicle, mapping.table)
        learned = lay(with_map(load_table(None), floor.slope, floor.size))
        delay = vehicle.command_delay_s + float(floor.p[floor.model.index("delay")])
        told = None if "uncompensated" in path.name else measured
        loop = gains, columns, mapping.pose.queue
        goal = pair(columns, "ref_{}_m")
        rows = {
            "flight": pair(columns, "{}_m"),
            "learned map": flown(
                learned, told, vehicle.mass * floor.p[0], vehicle.mass, delay, *loop
            ),
            "measured map": flown(measured, told, vehicle.mass, vehicle.mass, delay, *loop),
        }
        for name, seen in rows.items():
            rms, radial = figures(seen, goal)
            print(f"{path.stem}, {name}: {rms:.1f} mm RMS, radius {radial:.1f} mm RMS")


if __name__ == "__main__":
    main()
