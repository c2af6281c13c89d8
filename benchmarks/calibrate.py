"""Accuracy of calibration and validation: synthetic vehicles, and the logs of three labs.

    python benchmarks/calibrate.py --quick

The labs' logs are read from ../shared/data beside the project (--data); without them only the
synthetic part runs. What is called unseen is left out of the fit: the last third of UKY's log, one
run of SPOT or ITA after the other.
"""

import argparse
import csv
import tempfile
from pathlib import Path

import numpy as np
from msgspec import structs

from sim_twin.ground import lay, tilt_at
from testbed.core.error import TestbedError
from testbed.identification.cameras import latency_of
from testbed.identification.columns import read_columns, read_sources
from testbed.identification.floor import flat_fit, learn_floor
from testbed.identification.jets import examine
from testbed.identification.mapping import load_mapping
from testbed.identification.model import VehicleModel
from testbed.identification.motion import (
    RefusedError,
    calibrate_motion,
    identifiable,
    interval,
    start_of,
    thrusts,
)
from testbed.identification.motion_log import read_motion_log
from testbed.identification.suspicion import suspicions
from testbed.identification.synthetic import drawn, excitation, flown_log, rough, steered
from testbed.identification.table_file import load_table
from testbed.identification.thrust_stand import thrust_of
from testbed.identification.validation import errors_ahead
from testbed.identification.vehicle_file import load_vehicle
from testbed.identification.windows import ahead_of, sliding, tiled

STAND = (0.4415, 0.4307, 0.4277, 0.4380, 0.4689, 0.4468, 0.4670, 0.4841)  # [N] UKY's table
WEIGHT = np.array([1e3, 1e3, 3e2])


def synthetic(count, seconds):
    """Random vehicles on a rough table: errors, coverage, dead jets, unexcited jets."""
    floater, table = load_vehicle("generic_8jet"), load_table("marble_6m")
    worst, inside, dead, silent = {}, {}, 0, 0
    for k in range(count):
        rng = np.random.default_rng(k)
        truth, ground = drawn(floater, rng), rough(table, rng, 3e-3, 1e-4)
        inputs = steered(truth, ground, floater, seconds, 0.1, rng)
        log = flown_log(truth, ground, inputs, seconds, rng)
        reach = float(np.abs(log.pose[:, :2]).max())
        bumpy = lay(ground)  # the true slope of a log is the mean along its path
        slope = np.mean([tilt_at(bumpy, *pose[:2]) for pose in log.pose], axis=0)
        found = calibrate_motion([log], floater)
        true = {
            "inertia": truth.inertia / floater.inertia, "com_x": truth.com[0],
            "com_y": truth.com[1], "delay": truth.valve.open_delay_s, "droop": truth.air.droop,
            "slope_x": slope[0], "slope_y": slope[1],
        }  # fmt: skip
        errors = {"reach": reach}
        for name, value in true.items():
            i = found.model.index(name)
            low, high = interval(found, i)
            inside.setdefault(name, []).append(low <= value <= high)
            errors[name] = abs(found.estimate.p[i] - value)
        for row, jet in zip(thrusts(found), truth.jets, strict=True):
            inside.setdefault("thrust", []).append(row["low_n"] <= jet.thrust <= row["high_n"])
            errors["thrust"] = max(errors.get("thrust", 0.0), abs(row["thrust_n"] / jet.thrust - 1))
        for name, error in errors.items():
            worst.setdefault(name, []).append(error)
        jets, bad = list(truth.jets), int(rng.integers(8))
        jets[bad] = structs.replace(jets[bad], thrust=1e-6)
        lame = structs.replace(truth, jets=jets)
        inputs = steered(lame, ground, floater, seconds, 0.1, rng)
        one = flown_log(lame, ground, inputs, seconds, rng)
        model = VehicleModel(floater, valves=True)
        states = {
            f.jet: f.state
            for f in examine(model, start_of(model, [one], floater), [tiled(one, 2.5)])
        }
        dead += [j for j, s in states.items() if s == "dead"] == [bad]
        used = np.arange(8) != bad
        part = steered(truth, ground, floater, 40.0, 0.1, rng, used)
        quiet = calibrate_motion([flown_log(truth, ground, part, 40.0, rng)], floater)
        row = thrusts(quiet)[bad]
        silent += (not row["identifiable"]) and identifiable(quiet, 0)
        print(f"  vehicle {k}: ", {n: float(f"{e:.3g}") for n, e in errors.items()}, flush=True)
    units = {"thrust": 1.0, "inertia": 1.0, "com_x": 1e3, "com_y": 1e3, "delay": 1e3,
             "slope_x": 1e3, "slope_y": 1e3, "droop": 1.0}  # fmt: skip
    print(f"synthetic: farthest from the middle {max(worst.pop('reach')):.2f} m")
    for name, errors in worst.items():
        scaled = units[name] * np.array(errors)
        print(f"synthetic {name}: median {np.median(scaled):.3g}, worst {scaled.max():.3g};"
              f" inside {sum(inside[name])} of {len(inside[name])} intervals")  # fmt: skip
    all_of_them = np.concatenate(list(inside.values()))
    print(f"synthetic: true values inside the 95 % intervals {all_of_them.mean():.1%}"
          f" of {len(all_of_them)}")  # fmt: skip
    print(
        f"synthetic: dead jet found {dead} of {count}; unexcited jet reported {silent} of {count}"
    )


def rms(logs, vehicle, horizon=3.0):
    figures = errors_ahead(logs, vehicle, horizon).figures()
    return 1e3 * (figures["position_rms_m"] or np.nan), figures["count"]


def uky(data):
    lab = load_vehicle("uky")
    log = read_motion_log(data / "uky/hardware_run_first_60_percent.csv", load_mapping("uky"))
    early, late = (log._replace(whole=part) for part in (log.t < 76.0, log.t >= 76.0))
    found = calibrate_motion([early], lab)
    own, theirs = rms([late], found.vehicle)[0], rms([late], lab)[0]
    bare = rms([late], structs.replace(lab, drag=0.0, spin_drag=0.0))[0]
    dead = [f.jet + 1 for f in found.jets if f.state == "dead"]
    print(f"UKY: jets found dead {dead}; unseen part 3 s ahead {own:.1f} mm, lab {theirs:.1f} mm,"
          f" ratio {own / theirs:.2f} (lab without its drag {bare:.1f} mm)")  # fmt: skip
    for j, stated in enumerate(STAND):
        columns = read_columns(
            data / f"uky/thrust_stand_jet{j + 1}.csv", ["t_s", "weight_g", "bitmask"]
        )
        found_n = thrust_of(columns, "t_s", "weight_g", "g", "bitmask")["thrust_n"]
        print(f"UKY stand, jet {j + 1}: {found_n:.4f} N, lab {stated:.4f} N"
              f" ({found_n / stated - 1:+.2%})")  # fmt: skip


def spot(data, quick):
    lab, mapping = load_vehicle("spot_red"), load_mapping("spot")
    paths = sorted((data / "spot").glob("red_2021-03*.csv.gz"))
    logs = {path: read_motion_log(path, mapping) for path in paths}
    others = {name: load_vehicle(name) for name in mapping.vehicles}
    whole = calibrate_motion(list(logs.values()), lab, others=others)
    low, high = interval(whole, whole.model.index("droop"))
    print(f"SPOT RED, March: droop {low:.2f} to {high:.2f};"
          f" in sample {rms(logs.values(), whole.vehicle)[0]:.1f} mm")  # fmt: skip
    errors = {"own": [], "lab": []}
    days = sorted({path.name.split("_")[2] for path in paths})
    for session in days[-2:] if quick else days:
        out = [log for path, log in logs.items() if path.name.split("_")[2] == session]
        rest = [log for path, log in logs.items() if path.name.split("_")[2] != session]
        vehicle = calibrate_motion(rest, lab).vehicle
        for name, one in (("own", vehicle), ("lab", lab)):
            figure, count = rms(out, one)
            if count:
                errors[name].append((figure, count))
    own, theirs = (
        np.sqrt(np.average([e[0] ** 2 for e in errors[n]], weights=[e[1] for e in errors[n]]))
        for n in ("own", "lab")
    )
    print(f"SPOT RED, each session unseen in turn, 3 s ahead: {own:.1f} mm, lab {theirs:.1f} mm,"
          f" ratio {own / theirs:.2f}")  # fmt: skip
    known = {**others, "fitted": whole.vehicle}
    rates = {"exchanged": [0, 0], "healthy": [0, 0]}
    for path in sorted((data / "spot").glob("*.csv.gz")):
        red = path.name.startswith("red")
        log = read_motion_log(path, mapping)
        for name in ("spot_red", "fitted", "spot_black"):
            kind = "healthy" if red == (name != "spot_black") else "exchanged"
            try:
                calibrate_motion([log], known[name], others=others)
                said = ""
            except RefusedError as error:
                said = "; ".join(one.text for one in error.suspicions)
            except TestbedError:
                continue  # too short to fit
            rates[kind][0] += bool(said)
            rates[kind][1] += 1
            print(f"SPOT {path.name[:-7]} given {name}: {said or 'fitted'}")
    for kind, (named, count) in rates.items():
        print(f"SPOT: {named} of {count} {kind} pairs of log and file named other-vehicle")


def exchanged(count):
    """Synthetic vehicles: a log of each against its own file and against another one's."""
    floater = load_vehicle("generic_8jet")
    wrong, healthy, pairs = 0, 0, 0
    for k in range(count):
        rng = np.random.default_rng(100 + k)
        truth = drawn(floater, rng)
        log = flown_log(truth, None, excitation(truth, 40.0, 0.1, rng), 40.0, rng)
        for name in ("generic_8jet", "generic_8jet_15kg", "uky", "spot_red", "spot_black"):
            own = load_vehicle(name)
            try:
                calibrate_motion([log], own)
                said = False
            except RefusedError:
                said = True
            if name == "generic_8jet":
                healthy += said
            else:
                wrong, pairs = wrong + said, pairs + 1
    print(f"synthetic: {wrong} of {pairs} exchanged files named, {healthy} of {count} healthy ones")


def rebuilt(count):
    """Synthetic vehicles with another mass or a jet moved, against the file from before."""
    floater = load_vehicle("generic_8jet")
    cases = {"healthy": (1.0, 0.0), "mass +20 %": (1.2, 0.0), "mass -20 %": (0.8, 0.0),
             "a jet moved by 20 mm": (1.0, 0.02), "a jet moved by 30 mm": (1.0, 0.03),
             "mass +20 %, a jet moved by 30 mm": (1.2, 0.03)}  # fmt: skip
    for what, (mass, beside) in cases.items():
        said, refused, right = 0, 0, 0
        for k in range(count):
            rng = np.random.default_rng(200 + k)
            truth = drawn(floater, rng)
            jets, j = list(truth.jets), int(rng.integers(8))
            (x, y), (px, py) = jets[j].position, jets[j].push
            jets[j] = structs.replace(jets[j], position=(x - py * beside, y + px * beside))
            truth = structs.replace(truth, jets=jets, mass=mass * truth.mass)
            log = flown_log(truth, None, excitation(truth, 40.0, 0.1, rng), 40.0, rng)
            try:
                found = calibrate_motion([log], floater).suspicions
            except RefusedError as error:
                found, refused = error.suspicions, refused + 1
            said += any(one.name == "other-vehicle" for one in found)
            right += any(f"jet {j + 1} pushes" in one.text for one in found)
        print(f"rebuilt, {what}: {said} of {count} named, {refused} of them refused,"
              f" {right} with the jet", flush=True)  # fmt: skip


def ita(data):
    vehicle, mapping = load_vehicle("ita"), load_mapping("ita")
    logs = [read_motion_log(path, mapping) for path in sorted((data / "ita").glob("dl*.csv"))]
    tracks = [log for log in logs if "track" in log.where]
    for log in tracks:
        rest = [other for other in logs if other is not log]
        windows = sliding(log, 1.0, 3.0, 0.5)
        last = np.array([len(rows) - 1 for rows in windows.rows])

        def error(model, p, windows=windows, last=last):
            off = ahead_of(model, p, windows, 1.0, WEIGHT)[np.arange(len(last)), last, :2]
            return 1e3 * np.sqrt(np.mean(np.sum(off**2, axis=1)))

        floor = learn_floor(rest, vehicle, (1.5, 1.5))
        flat, own = error(*flat_fit(rest, vehicle)), error(floor.model, floor.p)
        print(f"ITA {Path(log.where).stem} unseen, 3 s ahead: {own:.1f} mm with the map,"
              f" {flat:.1f} mm level, ratio {own / flat:.2f}")  # fmt: skip
    found = read_sources(data / "ita/camera_latency.csv", "source", "t_s", "angle_deg")
    camera, servo = found["camera"], found["servo"]
    late = latency_of(servo[:, 0], servo[:, 1], camera[:, 0], camera[:, 1])
    print(f"ITA camera latency {1e3 * late['latency_s']:.1f} ms"
          f" ({1e3 * late['low_s']:.1f} to {1e3 * late['high_s']:.1f})")  # fmt: skip


def mutations(data, count):
    """Damaged logs: how many are refused or noted with a reason."""
    rng = np.random.default_rng(0)
    cases = [("uky/hardware_run_first_60_percent.csv", "uky", "uky")]
    cases += [("spot/black_2021-03-06_1613_1.csv.gz", "spot", "spot_black"),
              ("spot/red_2021-03-06_1613_1.csv.gz", "spot", "spot_red")]  # fmt: skip
    named, silent = 0, []
    with tempfile.TemporaryDirectory() as folder:
        for k in range(count):
            file, mapping, vehicle = cases[k % len(cases)]
            kind = KINDS[k // len(cases) % len(KINDS)]
            path = Path(folder) / "log.csv"
            write_mutant(data / file, path, kind, load_mapping(mapping), rng)
            try:
                log = read_motion_log(path, load_mapping(mapping))
                said = [one.name for one in suspicions([log], load_vehicle(vehicle))] or log.notes
            except TestbedError as error:
                said = [str(error).splitlines()[0]]
            named += bool(said)
            if not said:
                silent.append((kind, Path(file).name))
    print(f"mutations: {named} of {count} named; not named: {silent}")


KINDS = (
    "missing column", "gap", "thousands", "swapped axes", "degrees", "clock back", "clock ahead",
    "mirrored", "millimetres", "heading sign", "milliseconds", "shuffled valves",
    "shifted commands", "percent", "cut off",
)  # fmt: skip


def write_mutant(source, path, kind, mapping, rng):
    """A damaged copy of a log."""
    import gzip

    opened = gzip.open if source.suffix == ".gz" else open
    with opened(source, "rt", newline="") as file:
        head, *rows = list(csv.reader(file))
    at = {name: head.index(name) for name in head}
    pose, t = mapping.pose, at[mapping.time.column]
    x, y, q = at[pose.x], at[pose.y], at[pose.theta]
    valves = [at[name] for name in mapping.valves.columns]
    k = int(rng.integers(len(rows) // 3, 2 * len(rows) // 3))

    def scale(column, factor, rows=rows):
        for row in rows:
            if row[column]:
                row[column] = repr(float(row[column]) * factor)

    match kind:
        case "missing column":
            head[int(rng.choice([x, y, q, *valves]))] = "lost"
        case "gap":
            rows = rows[:k] + rows[k + int(rng.integers(20, 60)) :]
        case "thousands":
            rows[k][x] = "1,234.5"
        case "swapped axes":
            head[x], head[y] = head[y], head[x]
        case "degrees":
            scale(q, 180.0 / np.pi)
        case "clock back" | "clock ahead":
            step = float(rng.uniform(1.0, 9.0)) * (-1.0 if kind == "clock back" else 1.0)
            for row in rows[k:]:
                row[t] = repr(float(row[t]) + step)
        case "mirrored":
            scale(y, -1.0)
        case "millimetres":
            scale(x, 1e3)
            scale(y, 1e3)
        case "heading sign":
            scale(q, -1.0)
        case "milliseconds":
            scale(t, 1e3)
        case "shuffled valves":
            order = np.roll(valves, int(rng.integers(2, 7)))
            for a, b in zip(valves, order, strict=True):
                head[a] = mapping.valves.columns[int(np.flatnonzero(np.array(valves) == b)[0])]
        case "shifted commands":
            shift = int(rng.integers(len(rows) // 4, len(rows) // 2))
            moved = [[rows[(i + shift) % len(rows)][v] for v in valves] for i in range(len(rows))]
            for row, commands in zip(rows, moved, strict=True):
                for v, value in zip(valves, commands, strict=True):
                    row[v] = value
        case "percent":
            for v in valves:
                scale(v, 100.0)
        case "cut off":
            rows[-1] = rows[-1][: len(head) // 2]
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([head, *rows])


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="4 vehicles, 45 mutations")
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    parser.add_argument("--data", type=Path, default=beside, help="folder of the labs' logs")
    parser.add_argument("--only", metavar="PART", help="for instance uky; default: all")
    asked = parser.parse_args()
    parts = {
        "synthetic": lambda: synthetic(4 if asked.quick else 20, 120.0),
        "uky": lambda: uky(asked.data),
        "exchanged": lambda: exchanged(2 if asked.quick else 10),
        "rebuilt": lambda: rebuilt(4 if asked.quick else 20),
        "spot": lambda: spot(asked.data, asked.quick),
        "ita": lambda: ita(asked.data),
        "mutations": lambda: mutations(asked.data, 45 if asked.quick else 200),
    }
    if asked.only not in (None, *parts):
        parser.error(f"--only takes one of: {', '.join(parts)}")
    for name, part in parts.items():
        if asked.only not in (None, name):
            continue
        if name not in ("synthetic", "exchanged", "rebuilt") and not asked.data.is_dir():
            print(f"{name}: skipped, no logs at {asked.data}")
            continue
        part()


if __name__ == "__main__":
    main()
