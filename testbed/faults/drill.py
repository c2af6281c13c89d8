"""A drill: every kind of fault, injected many times, with the results.

This module draws the cases and judges them; the rig flies them.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from msgspec import Struct

from testbed.core.codes import FaultId, FaultReport, Response
from testbed.core.fault_injection import VALUES, Injection

LINK = ("link_late", "link_out", "link_lost")
NEIGHBOUR = ("neighbour_late", "neighbour_missing", "neighbour_silent")
# kind of injection -> ids of the faults that identify it
NAMES: dict[str, tuple[str, ...]] = {
    "drop_mocap": ("pose_stale", "pose_missing", "pose_lost"),
    "freeze_mocap": ("pose_frozen",),
    "jump_mocap": ("pose_jumped",),
    "noisy_mocap": ("estimator_inconsistent", "pose_jumped", "pose_stale"),
    "swap_bodies": ("pose_swapped",),
    "delay_link": LINK + NEIGHBOUR,
    "lose_link": LINK + NEIGHBOUR,
    "kill_process": (*NEIGHBOUR, FaultId.VEHICLE_SILENT),
    "stick_open": ("valve_stuck_open", "valve_leaks", "valve_leaks_or_weak"),
    "stick_closed": ("valve_stuck_closed", "valve_leaks_or_weak"),
    "leak_valve": ("valve_leaks", "valve_leaks_or_weak", "valve_stuck_open"),
    "leak": ("leak", "supply_weak", "supply_low"),
    "brown_out": ("battery_low", "board_silent"),
    "clock_step": ("clock_off",),
    "nan_law": ("not_a_number", FaultId.HOST_LAW_NOT_A_NUMBER),
    "raise_law": ("law_raised", FaultId.HOST_LAW_RAISED),
    "operator_gone": ("operator_gone",),
    "disk_full": ("disk_full",),
    "config_differs": ("config_differs",),
    "overrun": ("overrun",),
}
# time from detection until every valve must be shut: a plan in flight, or a stop; see docs
# [s]; braking: the longest stop on board, and the ticks before and after it
SHUT_WITHIN = {Response.BRAKE: 7.0, Response.COAST: 0.15, Response.LAND: 0.15}
DEAD_WITHIN = 0.25  # the last plan of a dead process, and its time to live [s]
ASKED = 1.5  # commanded open time before a jet without thrust can be noticed [s]
WHEN = (2.0, 12.0)  # range of the injection time [s]
ADRIFT = ("kill_process", "brown_out", "leak")  # the vehicle can no longer avoid a contact
OTHERS = ("kill_process",)  # faults that only other vehicles can detect
NEED_TWO = ("swap_bodies", *OTHERS)  # faults that need a second vehicle
SPREAD = {  # range of sizes, as factors of the usual size
    "jump_mocap": (0.5, 3.0),
    "noisy_mocap": (0.5, 3.0),
    "delay_link": (1.0, 3.0),
    "lose_link": (1.0, 1.0),
    "leak": (0.5, 2.0),
    "leak_valve": (0.5, 2.0),
    "clock_step": (0.5, 10.0),
    "overrun": (0.8, 3.0),
}


class Drilled(Struct, frozen=True):
    """One injection and its result."""

    kind: str
    experiment: str
    vehicle: str
    seed: int
    at_s: float
    named: str  # id of the first fault that identifies it; empty: undetected
    detected_s: float | None  # from its beginning to the response of the affected vehicle
    response: Response  # the most severe one of the affected vehicle
    shut_s: float | None  # from its beginning until all valves were shut; None: the run continued
    late: int  # valves still open after the deadline
    contacts: int  # during the flight, and hard ones in the minute after
    travelled_m: float  # longest distance of any vehicle from its position at the beginning
    fault: FaultReport | None  # that ended the run
    early: tuple[str, ...]  # faults latched before it began
    adrift: int  # contacts of a vehicle without thrust, or caused by a moving obstacle
    dormant: bool  # it had no effect: for example a valve stuck shut that was not commanded
    contacts_after: int = 0  # part of `contacts` in the minute after the end
    at_rest_s: float | None = None  # from the end until all vehicles rested; null: never
    air: str = "off"  # bearing air a minute after the end; "on": at least one vehicle
    again: str = ""  # the command that flies it again


class DrillRow(Struct, frozen=True):
    """One kind of injection, all its cases."""

    kind: str
    cases: int
    undetected: int  # without dormant cases
    dormant: int
    detected_median_s: float | None
    detected_worst_s: float | None
    response: str
    shut_worst_s: float | None
    travelled_worst_m: float
    contacts: int
    adrift: int
    valves_open_after_deadline: int
    contacts_after: int = 0
    moving: int = 0  # cases in which a vehicle was not at rest a minute after the end
    air_on: int = 0  # cases in which a vehicle had bearing air then


class Drill(Struct, frozen=True):
    """The output of `testbed drill --json`."""

    rig: str
    injections: int
    undetected: int
    dormant: int
    valves_open_after_deadline: int
    contacts: int  # without `adrift`, which no response can prevent
    contacts_adrift: int
    false_alarms: int
    rows: list[DrillRow]
    contacts_after: int = 0  # part of `contacts` in the minute after the end


def draw(kind: Any, vehicles: Sequence[str], jets: int, rng: np.random.Generator) -> Injection:
    """A random case of a kind, in the first seconds of a run."""
    who = rng.permutation(len(vehicles))
    low, high = SPREAD.get(kind, (1.0, 1.0))
    usual = VALUES.get(kind)
    return Injection(
        kind,
        vehicles[int(who[0])],
        at_s=round(float(rng.uniform(*WHEN)), 4),
        value=None if usual is None else round(usual * float(rng.uniform(low, high)), 4),
        jet=int(rng.integers(1, jets + 1)),
        other=vehicles[int(who[1])] if kind == "swap_bodies" else "",
    )


def names_of(fault: FaultReport) -> set[str]:
    """Ids of a fault, and of the other vehicle's fault with which it stops."""
    return {fault.id, fault.origin.id}


def answered(
    named: Sequence[tuple[float, str]], responses: Sequence[tuple[float, Response]], began: float
) -> tuple[str, float | None]:
    """The correct name of a fault, and the time from its beginning to the vehicle's response.

    Warnings also occur in flights without a fault: one counts only if nothing else followed.

    Args:
        named: times and correct names, for the affected vehicle.
        responses: times and responses of the affected vehicle.
        began: when the fault began [s].
    """
    if not named:
        return "", None
    since: dict[str, float] = {}  # each name, and its first time
    for t, name in sorted(named):
        since.setdefault(name, t)
    first = min(since.values())
    acted = min((t for t, one in responses if t >= began and one != Response.WARN), default=first)
    # the last name before the response caused it; a host may report it later
    known = {name: t for name, t in since.items() if t <= acted} or since
    return max(known, key=known.__getitem__), acted - began


def deadline(response: Response) -> float:
    """Time from detection until every valve must be shut [s]."""
    return SHUT_WITHIN.get(response, math.inf)


def summarise(rig: str, cases: Sequence[Drilled]) -> Drill:
    """Summarise all cases in one row per kind."""
    rows = []
    for kind in dict.fromkeys(one.kind for one in cases):
        own = [one for one in cases if one.kind == kind]
        found = [one.detected_s for one in own if one.detected_s is not None]
        shut = [one.shut_s for one in own if one.shut_s is not None]
        responses = {one.response for one in own if one.response}
        rows.append(
            DrillRow(
                kind,
                len(own),
                sum(one.detected_s is None and not one.dormant for one in own),
                sum(one.dormant for one in own),
                float(np.median(found)) if found else None,
                max(found, default=None),
                ", ".join(one.words for one in sorted(responses)),
                max(shut, default=None),
                max(one.travelled_m for one in own),
                sum(one.contacts for one in own),
                sum(one.adrift for one in own),
                sum(one.late for one in own),
                sum(one.contacts_after for one in own),
                sum(one.at_rest_s is None for one in own),
                sum(one.air == "on" for one in own),
            )
        )
    return Drill(
        rig,
        len(cases),
        sum(row.undetected for row in rows),
        sum(row.dormant for row in rows),
        sum(row.valves_open_after_deadline for row in rows),
        sum(row.contacts for row in rows),
        sum(row.adrift for row in rows),
        sum(bool(one.early) for one in cases),
        rows,
        sum(row.contacts_after for row in rows),
    )
