"""Admission: what an experiment is predicted to do, against what it may do, before anybody arms.

The experiment is flown some times in the twin, each time with another draw of everything that the
files only promise. Here are the limits and the judgement; flying is the rig's.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from testbed.core.vehicle import NonNegative, Positive
from testbed.metrics.fault_line import mishap
from testbed.metrics.run_metrics import Track

Array = NDArray[np.float64]


class AdmissionParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of an experiment that may be flown on hardware."""

    edge_m: NonNegative = 0.05  # between a rim and the fence
    separation_m: NonNegative = 0.05  # between the rims of two vehicles
    solid_m: NonNegative = 0.05  # between a rim and what really stands there
    gas_share: Positive = 0.8  # of a full tank
    openings_per_valve: Positive = 20_000  # [1] a thousandth of a solenoid's life    [assumed]
    contacts: int = 0
    faults: int = 0


class Flown(Struct, frozen=True):
    """One flight in the twin."""

    seed: int
    fault: str | None
    contacts: int
    edge_m: float  # nearest rim to the fence
    separation_m: float | None  # nearest two rims; None: there is one vehicle only
    solid_m: float | None  # nearest rim to a solid obstacle; None: there is none
    gas_share: float  # of the thirstiest vehicle
    openings_per_valve: float  # of the busiest vehicle, mean over its valves
    fault_t: float | None = None  # when the fault was found [s]


class Finding(Struct, frozen=True):
    """One limit."""

    name: str
    worst: float
    limit: float
    kept: bool
    seed: int  # of the worst flight
    words: str


class Admission(Struct, frozen=True):
    """The judgement."""

    experiment: str
    flights: int
    admitted: bool
    findings: list[Finding]
    faults: list[str] = []  # of each flight that ended in one, in words


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
    """Smallest room between a vehicle's centre and where it may be [m]."""
    room = [
        float((np.array(own) - np.abs(track.states[:, k, :2])).min()) for k, own in enumerate(half)
    ]
    return min(room)


def judge_flights(experiment: str, flights: Sequence[Flown], limits: AdmissionParams) -> Admission:
    """The worst of all flights against every limit."""
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
    at_most("gas of the tank", each("gas_share"), limits.gas_share, "of it")
    at_most(
        "openings of a valve", each("openings_per_valve"), limits.openings_per_valve, "openings"
    )
    kept = all(one.kept for one in findings)
    words = [mishap(f.seed, f.fault, f.fault_t) for f in flights if f.fault is not None]
    return Admission(experiment, len(flights), kept, findings, words)
