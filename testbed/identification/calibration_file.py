"""Results of a calibration, as JSON and as comments of the vehicle file."""

from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from testbed.identification.floor import Array, Floor
from testbed.identification.model import VehicleModel
from testbed.identification.motion import SURE, Calibration, identifiable, interval, thrusts
from testbed.identification.motion_log import MotionLog
from testbed.identification.vehicle_file import write_vehicle

CUT = "0, because no delay is negative"


def report_of(c: Calibration, name: str, logs: Sequence[MotionLog]) -> dict[str, Any]:
    """The calibration for --json."""
    rows = {}
    for k, own in enumerate(c.model.parameters):
        if own.group == "jets":
            continue
        factor = _factor(c.model, own.name)
        low, high = interval(c, k)
        rows[own.name] = {
            "value": factor * float(c.estimate.p[k]), "low": factor * low, "high": factor * high,
            "file": factor * float(own.value), "unit": own.unit or _unit(own.name),
            "chosen": bool(k in c.estimate.free), "identifiable": identifiable(c, k),
        }  # fmt: skip
    jets = thrusts(c) if c.model.valves else []
    unknown = [n for n, row in rows.items() if not row["identifiable"]]
    unknown += [f"thrust of jet {row['jet']}" for row in jets if not row["identifiable"]]
    kept = [n for n, row in rows.items() if not (row["identifiable"] or row["chosen"])]
    kept += [f"thrust of jet {r['jet']}" for r in jets if r["kept"] and not r["identifiable"]]
    unknown += ["mass (only thrust over mass)"] if c.model.valves else []
    return {
        "vehicle": name,
        "logs": [
            {"file": log.where, "sha256": log.digest, "used_s": used_s(log), "notes": log.notes}
            for log in logs
        ],
        "parameters": rows,
        "jets": jets,
        "findings": findings(c),
        "not_identifiable": unknown,
        "kept": kept,
        "chosen": c.chosen,
        "gains": c.gains,
        "suspicions": [{"name": one.name, "text": one.text} for one in c.suspicions],
        "noise": {
            "position_m": float(c.estimate.noise[0]), "heading_rad": float(c.estimate.noise[2]),
        },
    }  # fmt: skip


def findings(c: Calibration) -> list[str]:
    """Jets that are not what the file says, in words."""
    lines = []
    for one in c.jets:
        if one.state == "exchanged" and one.other < one.jet:
            continue  # named with the other
        text = {
            "dead": f"jet {one.jet + 1} is dead or nearly so",
            "weak": f"jet {one.jet + 1} is weak: {one.share:.0%} of the others",
            "exchanged": f"jets {one.jet + 1} and {one.other + 1} are exchanged",
            "not excited": f"jet {one.jet + 1} is hardly excited: its thrust is not identifiable",
        }.get(one.state)
        lines += [text] if text else []
    return lines


def used_s(log: MotionLog) -> float:
    """Time of undisturbed flight in a log [s]."""
    return float(np.median(np.diff(log.t)) * log.whole.sum())


def span(log: MotionLog) -> str:
    """The part of a log that was used, in words."""
    t = log.t[log.whole]
    return (
        f"{used_s(log):.1f} s of t = {round(t[0], 3):.15g} to {round(t[-1], 3):.15g} s"
        if len(t)
        else "nothing"
    )


def save(path: Path, c: Calibration, name: str, logs: Sequence[MotionLog], day: date) -> None:
    """Write the fitted vehicle with the origin of each number."""
    notes: dict[str, str] = {}
    for k, own in enumerate(c.model.parameters):
        place = PLACES.get(own.name)
        if place is None:
            continue
        factor = _factor(c.model, own.name)
        low, high = (factor * one for one in interval(c, k))
        if k in c.estimate.free:
            text = f"fitted, {low:.4g} to {high:.4g}"
        elif identifiable(c, k):
            text = f"as in {name}; these logs: {low:.4g} to {high:.4g}"
        else:
            text = f"as in {name}, not identifiable"
        if own.name == "delay" and c.estimate.p[k] < 0.0:
            text = f"{CUT}; {text}"
        notes[place] = _add(notes.get(place), f"{own.name}: {text}")
    if c.model.valves:
        notes["mass"] = f"as in {name}: only thrust over mass is identifiable"
        notes["valve.close_delay_s"] = f"open_delay_s + hold; {notes['valve.close_delay_s']}"
    else:
        notes["valve.close_delay_s"] = f"open_delay_s, and the difference of {name}"
    if c.vehicle.valve.min_off_s != c.model.vehicle.valve.min_off_s:
        notes["valve.min_off_s"] = f"longer than in {name}: the valve closes until then"
    for row in thrusts(c) if c.model.valves else []:
        notes[f"jets.{row['jet'] - 1}"] = _of_jet(row, name)
    origin = [f"{Path(log.where).name}, sha256 {log.digest}, {span(log)}" for log in logs]
    origin.append(f"values that were not fitted: vehicle {name}")
    p = c.estimate.p
    slope = [p[c.model.index(axis)] for axis in ("slope_x", "slope_y")]
    origin.append(f"slope of the table in these logs: {slope[0]:.5f}, {slope[1]:.5f} m/s^2")
    write_vehicle(path, c.vehicle, notes, origin, day)


def save_with_map(path: Path, found: Floor, name: str, origin: list[str], day: date) -> None:
    """Write the vehicle that was fitted with a slope map, with the origin of each number."""
    model, free = found.model, list(found.free)
    notes: dict[str, str] = {}

    def reach(value: float, slope: Array, least: float = 0.0) -> str:
        wide = SURE * float(np.sqrt(slope @ found.covariance @ slope))
        return f"{max(least, value - wide):.4g} to {value + wide:.4g}"

    for k, own in enumerate(model.parameters):
        place = PLACES.get(own.name)
        if place is not None and k in free:
            factor = _factor(model, own.name)
            slope = np.where(found.free == k, factor, 0.0)
            text = reach(factor * float(found.p[k]), slope, factor * own.least)
            cut = f"{CUT}; " if own.name == "delay" and found.p[k] < 0.0 else ""
            text = f"{own.name}: {cut}fitted with the slope map, {text}"
            notes[place] = _add(notes.get(place), text)
    for k, jet in enumerate(model.vehicle.jets if model.valves else []):
        slope = np.zeros(len(free))
        slope[free.index(0)], slope[free.index(1 + k)] = found.p[1 + k], found.p[0]
        value = jet.thrust * float(model.thrust(found.p)[k])
        notes[f"jets.{k}"] = f"fitted with the slope map, {reach(value, jet.thrust * slope)} N"
    if model.valves:
        notes["mass"] = f"as in {name}: only thrust over mass is identifiable"
    notes["valve.close_delay_s"] = f"open_delay_s, and the difference of {name}"
    origin = [*origin, f"values that were not fitted: vehicle {name}"]
    write_vehicle(path, model.fitted(found.p), notes, origin, day, "calibrate floor")


PLACES = {
    "mass": "mass", "inertia": "inertia", "com_x": "com", "com_y": "com", "drag": "drag",
    "spin_drag": "spin_drag", "delay": "valve.open_delay_s", "hold": "valve.close_delay_s",
    "droop": "air.droop",
}  # fmt: skip


def _of_jet(row: Mapping[str, Any], name: str) -> str:
    """Where the thrust of a jet comes from, in words."""
    reach = f"{row['low_n']:.4g} to {row['high_n']:.4g} N"
    words = "" if row["state"] == "ok" else f", {row['state']}"
    if row["fitted"]:
        alone = "" if row["identifiable"] else ", with the other jets: not identifiable alone"
        return f"fitted, {reach}{words}{alone}"
    if row["kept"]:
        note = "" if row["identifiable"] else ", not identifiable"
        return f"as in {name}{words}{note}; these logs: {reach}"
    if not row["identifiable"]:
        return f"as in {name}, times the common thrust{words}; not identifiable alone, {reach}"
    return f"fitted, {reach}{words}"


def _add(before: str | None, text: str) -> str:
    return f"{before}; {text}" if before else text


def _factor(model: VehicleModel, name: str) -> float:
    """Factor from the model's relative numbers to SI units."""
    return {"mass": model.vehicle.mass, "inertia": model.vehicle.inertia}.get(name, 1.0)


def _unit(name: str) -> str:
    return {"mass": "kg", "inertia": "kg m^2"}.get(name, "1")
