"""`testbed commission --rig bench` against errors planted behind real wires and real firmware.

    python benchmarks/commission_bench.py [--only WORD] [--vehicle generic_8jet] [--healthy 1]

The errors are those of the fault injection, from the first second. An error is named when a verdict
has one of its codes. The frame step needs a person and is left out on the bench, so errors that
only it finds are not planted. A case takes about 75 s.
"""

import argparse
import json
import subprocess
import sys
import tempfile

from testbed.config.shipped import SHIPPED

ERRORS: dict[str, tuple[str, set[str]]] = {  # what is injected, verdicts that name it
    "wires of jets 2 and 5 exchanged": (
        'kind = "swap_jets", jet = 2, value = 5.0', {"wires_swapped"}),
    "wires of jets 1 and 6 exchanged": (
        'kind = "swap_jets", jet = 1, value = 6.0', {"wires_swapped"}),
    "jet 3 pushes the other way": ('kind = "reverse_jet", jet = 3', {"jet_reversed", "jet_unlike"}),
    "valve 4 is stuck open": ('kind = "stick_open", jet = 4', {"leak"}),
    "valve 7 is stuck shut": ('kind = "stick_closed", jet = 7', {"dead", "silent_valve"}),
    "valve 5 leaks a fifth": ('kind = "leak_valve", jet = 5, value = 0.2', {"leak"}),
    "valve 2 stays half open": ('kind = "half_open", jet = 2', {"leak"}),
    "jet 6 gives half": ('kind = "weak_jet", jet = 6', {"jet_weak"}),
    "jet 1 gives a fiftieth": ('kind = "weak_jet", jet = 1, value = 0.02', {"dead"}),
    "a hose pulls": ('kind = "hose", value = 0.05, towards_deg = 30.0', {"hose", "pulled"}),
    "pads drag": ('kind = "pad_drag"', {"drag"}),
    "regulator at 150 %": ('kind = "regulator"', {"pressure_high"}),
    "supply reads half": ('kind = "sag"', {"pressure_low"}),
    "battery is flat": ('kind = "flat_battery"', {"battery"}),
    "jets give two thirds": ('kind = "thrust"', {"all_weak"}),
    "mass is half as much again": ('kind = "mass"', {"all_weak"}),
    "four poses a second": ('kind = "slow_mocap"', {"camera_rate"}),
    "noise of 5 mm": ('kind = "noisy_mocap", value = 0.005', {"camera_noise"}),
    "stream frozen": ('kind = "freeze_mocap", value = 0.0', {"camera_frozen"}),
    "millimetres for metres": ('kind = "scale_frame"', {"units"}),
    "poses 0.2 s late": ('kind = "delay_mocap", value = 0.2', {"late"}),
    "no poses": ('kind = "drop_mocap"', {"no_poses", "untracked", "camera_rate"}),
    "body registered 90 deg off": (
        'kind = "turn_body", value = 90.0', {"body_turned", "all_turned"}),
    "bodies of two vehicles exchanged": (
        'kind = "swap_bodies", other = "sat2"', {"bodies_swapped", "boards_swapped"}),
    "boards of two vehicles exchanged": (
        'kind = "swap_boards", other = "sat2"', {"boards_swapped", "bodies_swapped"}),
}  # fmt: skip


def verdicts(vehicle: str, error: str, seed: int) -> list[dict[str, str]]:
    """Commission a vehicle on the bench; its verdicts that found something."""
    model = SHIPPED / "vehicles" / f"{vehicle}.toml"
    words = [f"seed={seed}", f'vehicles.sat1.model="{model}"', "vehicles.sat1.start=[-1.0,0.2,0.0]"]
    if "other" in error:
        words.append(f'vehicles.sat2={{model="{model}",start=[0.9,-0.3,0.0],goal=[0.9,-0.3,0.0]}}')
    if error:
        words.append(f'inject=[{{vehicle = "sat1", at_s = 0.0, {error}}}]')
    with tempfile.TemporaryDirectory() as folder:
        command = ("-m", "testbed.cli.start", "commission", "hold", "--rig", "bench", "--yes")
        done = subprocess.run(
            [sys.executable, *command, "--json", "--out", f"{folder}/run", *words],
            capture_output=True, text=True, timeout=400,
        )  # fmt: skip
    try:
        found = json.loads(done.stdout)["verdicts"]
    except ValueError:
        return [{"code": f"exit {done.returncode}", "text": done.stderr[-500:]}]
    return [one for one in found if one["code"]]


def main() -> int:
    """Plant, commission, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--vehicle", default="generic_8jet")
    parser.add_argument("--only", default="", help="errors whose name contains this")
    parser.add_argument("--healthy", type=int, default=1)
    args = parser.parse_args()
    named, planted, false = 0, 0, 0
    for k, (name, (error, codes)) in enumerate(ERRORS.items()):
        if args.only not in name:
            continue
        found = verdicts(args.vehicle, error, k)
        good = bool({one["code"] for one in found} & codes)
        planted, named = planted + 1, named + good
        said = "; ".join(f"{one['code']}: {one['text']}" for one in found) or "nothing"
        print(f"{'named' if good else 'NOT NAMED':9} {name}: {said}", flush=True)
    for seed in range(args.healthy):
        found = verdicts(args.vehicle, "", 100 + seed)
        false += bool(found)
        print(f"healthy, seed {100 + seed}: {found or 'nothing found'}", flush=True)
    print(f"{named} of {planted} planted errors named on the bench; {false} false alarms")
    return int(named < planted or false > 0)


if __name__ == "__main__":
    sys.exit(main())
