"""A drill: the whole catalogue of faults, each injected many times, and what became of it.

Here is what is asked for and how it is judged; flying it is the rig's.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from msgspec import Struct

from testbed.core.fault_injection import VALUES, Injection
from testbed.flight.faults import SEVERITY

# kind of injection -> rows of the fault table, or words of a gate, that name it rightly
NAMES: dict[str, tuple[str, ...]] = {
    "drop_mocap": ("pose_stale", "pose_lost"),
    "freeze_mocap": ("pose_frozen",),
    "jump_mocap": ("pose_jumped",),
    "noisy_mocap": ("estimator_inconsistent", "pose_jumped", "pose_stale"),
    "swap_bodies": ("pose_swapped",),
    "delay_link": ("link_late", "link_out", "link_lost", "neighbour_late", "neighbour_silent"),
    "lose_link": ("link_late", "link_out", "link_lost", "neighbour_late", "neighbour_silent"),
    "kill_process": ("neighbour_late", "neighbour_silent", "vehicle_silent"),
    "stick_open": ("valve_stuck_open", "valve_leaks", "valve_leaks_or_weak"),
    "stick_closed": ("valve_stuck_closed", "valve_leaks_or_weak"),
    "leak_valve": ("valve_leaks", "valve_leaks_or_weak", "valve_stuck_open"),
    "leak": ("leak", "supply_weak", "supply_low"),
    "brown_out": ("battery_low", "board_silent"),
    "clock_step": ("clock_off",),
    "nan_law": ("not_a_number", "law on the host: asks for something that is not a number"),
    "raise_law": ("law_raised", "law on the host: SabotageError"),
    "operator_gone": ("operator_gone",),
    "disk_full": ("disk_full",),
    "config_differs": ("config_differs",),
    "overrun": ("overrun",),
}
# how long after it is detected every valve must be shut: a plan in flight, or a stop; see docs
SHUT_WITHIN = {"": math.inf, "warn": math.inf, "hold": math.inf, "coast": 0.15, "land": 0.15}
BRAKE_WITHIN = 7.0  # [s] the longest stop on board, and the ticks before and after it
DEAD_WITHIN = 0.25  # [s] a plan that a dead process has sent, and its time to live
ASKED = 1.5  # [s] of open time that a jet must be asked for before its silence can be noticed
WHEN = (2.0, 12.0)  # [s]
ADRIFT = ("kill_process", "brown_out", "leak")  # these take a vehicle's means to push away
OTHERS = ("kill_process",)  # faults that only the others can name
SPREAD = {  # sizes that are drawn, as factors of what is usual
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
    """One injection and what became of it."""

    kind: str
    experiment: str
    vehicle: str
    seed: int
    at_s: float
    named: str  # the first row or words that name it; empty: undetected
    detected_s: float | None  # from its beginning to the response of the vehicle concerned
    response: str  # the most severe of the vehicle concerned
    shut_s: float | None  # last valve shut after it began; None: the run went on
    late: int  # valves still open after the deadline
    contacts: int  # while it flew, and hard ones in the minute after
    travelled_m: float  # the farthest that any vehicle got from where it was when it began
    fault: str | None  # how the run ended
    early: tuple[str, ...]  # faults that were latched before it began
    adrift: int  # contacts of one that could not push any more, or that a moving obstacle ran into
    dormant: bool  # it had no occasion to show: a valve that is stuck shut and not asked for
    contacts_after: int = 0  # of `contacts` those in the minute after the end
    at_rest_s: float | None = None  # after the end, the last vehicle; null: one never was
    air: str = "off"  # bearing air a minute after the end; "on": of one vehicle at least


class Row(Struct, frozen=True):
    """One kind of injection, all its cases."""

    kind: str
    cases: int
    undetected: int  # without the dormant
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
    air_on: int = 0  # cases in which a bearing had air then


class Drill(Struct, frozen=True):
    """What `testbed drill --json` prints."""

    rig: str
    injections: int
    undetected: int
    dormant: int
    valves_open_after_deadline: int
    contacts: int  # but for those adrift: no response can prevent them
    contacts_adrift: int
    false_alarms: int
    rows: list[Row]
    contacts_after: int = 0  # of the contacts those in the minute after the end


def draw(kind: Any, vehicles: Sequence[str], jets: int, rng: np.random.Generator) -> Injection:
    """A random case of a kind, in the first seconds of a run that begins anywhere on the table."""
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


def answered(
    named: Sequence[tuple[float, str]], responses: Sequence[tuple[float, str]], began: float
) -> tuple[str, float | None]:
    """What names a fault rightly, and how long after its beginning the vehicle did something.

    A warning comes in flights without a fault, too: it counts only where nothing else followed.

    Args:
        named: time and right name, of whom it concerns.
        responses: time and response of the vehicle concerned.
        began: when the fault did [s].
    """
    if not named:
        return "", None
    since: dict[str, float] = {}  # each name, and when it was said first
    for t, name in sorted(named):
        since.setdefault(name, t)
    first = min(since.values())
    acted = min((t for t, one in responses if t >= began and one != "warn"), default=first)
    # the last that came before the response is what it was for; a host may say it afterwards
    known = {name: t for name, t in since.items() if t <= acted} or since
    return max(known, key=known.__getitem__), acted - began


def deadline(response: str) -> float:
    """How long after detection every valve must be shut [s]."""
    return BRAKE_WITHIN if response == "brake" else SHUT_WITHIN[response]


def summarise(rig: str, cases: Sequence[Drilled]) -> Drill:
    """The table."""
    rows = []
    for kind in dict.fromkeys(one.kind for one in cases):
        own = [one for one in cases if one.kind == kind]
        found = [one.detected_s for one in own if one.detected_s is not None]
        shut = [one.shut_s for one in own if one.shut_s is not None]
        responses = {one.response for one in own if one.response}
        rows.append(
            Row(
                kind,
                len(own),
                sum(one.detected_s is None and not one.dormant for one in own),
                sum(one.dormant for one in own),
                float(np.median(found)) if found else None,
                max(found, default=None),
                ", ".join(sorted(responses, key=SEVERITY.__getitem__)),
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
