"""What a commissioning leaves: a report, a measured vehicle file, and the record for arming."""

from collections.abc import Sequence
from datetime import date
from pathlib import Path

import msgspec
import numpy as np
from msgspec.structs import replace

from testbed.commission.jets import Pulse, strength_of
from testbed.commission.procedure import Commissioned
from testbed.commission.verdict import Verdict
from testbed.config import Experiment
from testbed.core.vehicle import Vehicle
from testbed.files import write_atomic
from testbed.identification.vehicle_file import write_vehicle


def lines_of(verdicts: Sequence[Verdict]) -> list[str]:
    """The verdicts as text, one a line."""
    return [f"{v.vehicle:8} {v.step:9} {mark_of(v):8} {v.text}" for v in verdicts]


def mark_of(verdict: Verdict) -> str:
    """How a verdict reads."""
    return "left out" if verdict.skipped else "WRONG" if verdict.code else "ok"


def passed(verdicts: Sequence[Verdict], name: str) -> bool:
    """Whether every step was done on a vehicle, and found nothing wrong."""
    own = [v for v in verdicts if v.vehicle == name]
    return "jets" in {v.step for v in own} and not any(
        v.code or (v.skipped and v.step != "pressure") for v in own
    )


def measured(vehicle: Vehicle, pulses: Sequence[Pulse]) -> tuple[Vehicle, dict[str, str]]:
    """The vehicle with the thrust of each jet as measured, and the comments of the numbers."""
    found, notes = strength_of(vehicle, pulses), dict[str, str]()
    jets = list(vehicle.jets)
    for k, jet in enumerate(jets):
        if np.isfinite(found.sigma[k]) and found.share[k] > 0.0:
            thrust = jet.thrust * float(found.share[k])
            error = 1.96 * jet.thrust * float(found.sigma[k])
            notes[f"jets.{k}"] = f"+- {error:.2g} N, if the mass is right"
            jets[k] = replace(jet, thrust=thrust)
    late = float(np.median(found.delay))
    delay = max(0.0, vehicle.valve.open_delay_s + late)
    closes = max(0.0, vehicle.valve.close_delay_s + late)
    notes["valve.open_delay_s"] = f"{round(1e3 * late):+d} ms beside the file"
    valve = replace(vehicle.valve, open_delay_s=delay, close_delay_s=closes)
    return replace(vehicle, jets=jets, valve=valve), notes


def write_report(folder: Path, experiment: Experiment, done: Commissioned, rig: str) -> None:
    """Write commission.json, commission.txt, and NAME.toml of each vehicle that was measured.

    Raises:
        OSError, TestbedError: they cannot be written.
    """
    tree = {"experiment": experiment.name, "rig": rig, "verdicts": done.verdicts}
    write_atomic(folder / "commission.json", msgspec.json.format(msgspec.json.encode(tree)))
    text = "\n".join([*lines_of(done.verdicts), ""])
    write_atomic(folder / "commission.txt", text.encode())
    for name, pulses in done.pulses.items():
        if not passed(done.verdicts, name):
            continue
        vehicle, notes = measured(experiment.vehicles[name].model, pulses)
        origin = [f"one pulse of each jet on the {rig}, {folder / 'commission.json'}"]
        write_vehicle(folder / f"{name}.toml", vehicle, notes, origin, date.today(), "commission")
