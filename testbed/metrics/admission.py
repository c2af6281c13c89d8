"""Admission: compares the predicted behaviour of an experiment with limits, before arming.

The experiment is flown several times on the twin, each time with other random draws of the
tolerances. This module has the limits and the judgement; the rig flies.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from testbed.core.codes import FaultReport
from testbed.core.vehicle import NonNegative, Positive
from testbed.metrics.fault_line import fault_line
from testbed.metrics.run_metrics import Track

Array = NDArray[np.float64]


class AdmissionParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Limits for flying an experiment on hardware."""

    edge_m: NonNegative = 0.05  # between a rim and the fence
    separation_m: NonNegative = 0.05  # between the rims of two vehicles
    solid_m: NonNegative = 0.05  # between a rim and a solid obstacle
    gas_share: Positive = 0.8  # of a full tank
    openings_per_valve: Positive = 20_000  # [1] a thousandth of a solenoid's life    [assumed]
    contacts: int = 0
    faults: int = 0


class AdmissionFlight(Struct, frozen=True):
    """One flight on the twin."""

    seed: int
    fault: FaultReport | None
    contacts: int
    edge_m: float  # nearest rim to the fence
    separation_m: float | None  # nearest two rims; None: only one vehicle
    solid_m: float | None  # nearest rim to a solid obstacle; None: no solid obstacle
    gas_share: float  # largest of all vehicles
    openings_per_valve: float  # largest of all vehicles, mean over its valves
    fault_t: float | None = None  # when the fault was found [s]


class Finding(Struct, frozen=True):
    """Worst value of one metric against its limit."""

    name: str
    worst: float
    limit: float
    kept: bool
    seed: int  # of the worst flight
    words: str


class Admission(Struct, frozen=True):
    """Result of the admission."""

    experiment: str
    flights: int
    admitted: bool
    findings: list[Finding]
    faults: list[str] = []  # text of the fault of each flight that ended in one


def nearest_rims(track: Track, radii: Sequence[float]) -> float | None:
    """Smallest gap between the rims of any two vehicles [m]."""
    xy = track.states[:, :, :2]
    gaps = [
        float(np.hypot(*(xy[:, i] - xy[:, j]).T).min()) - radii[i] - radii[j]
        for i in range(len(radii))
        for j in range(i)
    ]
    return min(gaps, default=None)


def nearest_edge(track: Track, half: Sequence[tuple[float, float]]) -> float:
    """Smallest distance of a vehicle's centre from the border of its allowed area [m]."""
    room = [
        float((np.array(own) - np.abs(track.states[:, k, :2])).min()) for k, own in enumerate(half)
    ]
    return min(room)


def judge_flights(
    experiment: str, flights: Sequence[AdmissionFlight], limits: AdmissionParams
) -> Admission:
    """Compare the worst of all flights with every limit."""
    findings: list[Finding] = []

    def at_least(name: str, values: Mapping[int, float], limit: float, unit: str) -> None:
        if not values:
            return
        seed = min(values, key=values.__getitem__)
        words = f"{values[seed]:.3f} {unit}, at least {limit:g} {unit}"
        findings.append(Finding(name, values[seed], limit, values[seed] >= limit, seed, words))

    def at_most(name: str, values: Mapping[int, float], limit: float, unit: str) -> None:
        seed = max(values, key=values.__getitem__)
        words = f"{values[seed]:.3g} {unit}, at most {limit:g} {unit}".replace(" ,", ",")
        findings.append(
            Finding(name, values[seed], limit, values[seed] <= limit, seed, words.strip())
        )

    def each(name: str) -> dict[int, float]:
        found = {one.seed: getattr(one, name) for one in flights}
        return {seed: value for seed, value in found.items() if value is not None}

    faults = {one.seed: float(one.fault is not None) for one in flights}
    ended = max(faults, key=faults.__getitem__)  # the first seed with one
    at_most("flights that end in a fault", {ended: sum(faults.values())}, limits.faults, "")
    at_most("contacts", each("contacts"), limits.contacts, "")
    at_least("room to the fence", each("edge_m"), limits.edge_m, "m")
    at_least("room between two vehicles", each("separation_m"), limits.separation_m, "m")
    at_least("room to a solid obstacle", each("solid_m"), limits.solid_m, "m")
    at_most("gas used", each("gas_share"), limits.gas_share, "of the tank")
    at_most(
        "openings of a valve", each("openings_per_valve"), limits.openings_per_valve, "openings"
    )
    kept = all(one.kept for one in findings)
    words = [fault_line(f.seed, f.fault, f.fault_t) for f in flights if f.fault is not None]
    return Admission(experiment, len(flights), kept, findings, words)
