"""A drill: every kind of fault, injected many times, with the results.

This module draws the cases and judges them; the rig flies them.
"""

import math
from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from testbed.core.codes import FaultReport, Response
from testbed.core.fault_injection import OF_FRAME, WITH_OTHER, Injection
from testbed.faults.catalogue import CATALOGUE
from testbed.flight.arming import Check

BESIDE_BRAKE = 1.0  # beside the longest stop on board: the ticks before and after it [s]
BESIDE_PLANS = 0.05  # beside the periods of plans in flight: their way to the valves [s]
ASKED = 1.5  # commanded open time before a jet without thrust can be noticed [s]
WHEN = (2.0, 12.0)  # range of the injection time [s]
# kinds after which the vehicle, and the other one of a swap, can no longer avoid a contact
ADRIFT = ("kill_process", "brown_out", "leak", "empty_tank", "swap_boards")
OTHERS = ("kill_process", "stop_process")
# rows that also hold in flights without a fault
ROUTINE = ("pose_stale", "neighbour_late", "link_late", "link_out", "neighbour_missing")


class Drilled(Struct, frozen=True):
    """One injection and its result."""

    kind: str  # of the catalogue
    experiment: str
    vehicle: str
    seed: int
    at_s: float
    named: str  # id of the first fault that identifies or answers it; empty: undetected
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
    refused: bool = False  # by the arming checks: nothing has moved
    called: str = ""  # id of the fault that ended the run, or of the first warning; empty: none
    said: str = ""  # its words
    rightly: bool | None = None  # whether it names the fault; null: nothing said, or `alike`

    @property
    def missed(self) -> bool:
        """Whether it should have been noticed and was not."""
        may_pass = self.dormant or CATALOGUE[self.kind].unnoticed
        return self.detected_s is None and not may_pass

    @property
    def alike(self) -> bool:
        """Whether it was called what it cannot be told from."""
        return self.called in CATALOGUE[self.kind].alike


class DrillRow(Struct, frozen=True):
    """One kind of injection, all its cases."""

    kind: str
    cases: int
    undetected: int  # without dormant cases, and those that the flight may go on with
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
    unnoticed: int = 0  # cases that nothing answered, and that the flight may go on with
    judged: int = 0  # cases in which something was said
    rightly: int = 0  # of them, those in which it was the right name
    called: dict[str, int] = {}  # ids that were said, and how often
    alike: int = 0  # cases that were called what they cannot be told from; not in `judged`


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


def cases_of(rig: str, vehicles: int) -> list[str]:
    """The cases that can be injected on a rig with so many vehicles."""
    return [
        name for name, case in CATALOGUE.items()
        if rig in case.rigs and (vehicles > 1 or case.kind not in (*WITH_OTHER, *OTHERS))
    ]  # fmt: skip


def draw(
    name: str, vehicles: Sequence[str], jets: int, period: float, rng: np.random.Generator
) -> Injection:
    """A random injection of a case, in the first seconds of a run.

    Args:
        name: in the catalogue.
        vehicles: names.
        jets: of the vehicle with the fewest.
        period: of the jets [s].
        rng: seeded.
    """
    case, who = CATALOGUE[name], rng.permutation(len(vehicles))
    at = round(float(rng.uniform(*WHEN)), 4)
    size = None if case.range is None else float(rng.uniform(*case.range))
    if size is not None and case.in_periods:
        size *= period
    jet = int(rng.integers(1, jets + 1))
    if case.kind == "swap_jets":
        size = float((jet - 1 + rng.integers(1, jets)) % jets + 1)
    drawn = Injection(
        case.kind,
        vehicles[int(who[0])],
        at_s=0.0 if case.at_start else at,
        value=None if size is None else round(size, 4) or size,
        jet=jet,
        other=vehicles[int(who[1])] if case.kind in WITH_OTHER else "",
    )
    if case.lasts is None:
        return drawn
    return replace(drawn, for_s=round(float(rng.uniform(*case.lasts)), 3))


def refused(
    name: str, experiment: str, what: Injection, seed: int, red: Sequence[Check]
) -> Drilled:
    """The result of a flight that did not start, because of these red checks."""
    named = next((one.id for one in red if one.id in CATALOGUE[name].names), "")
    return Drilled(
        name, experiment, what.vehicle, seed, 0.0, named, 0.0 if named else None, Response.NONE,
        None, 0, 0, 0.0, None, () if named else tuple(one.words for one in red), 0,
        dormant=False, at_rest_s=0.0, refused=True, called=named or red[0].id,
        said=red[0].words, rightly=bool(named),
    )  # fmt: skip


def concerned(what: Injection, name: str, *, silent: bool) -> bool:
    """Whether a vehicle's response counts; if the injected one is `silent`, the others' count."""
    if what.kind in OF_FRAME:
        return True
    return (name in (what.vehicle, what.other)) != silent


def without_means(what: Injection, touch: Iterable[str]) -> bool:
    """Whether a vehicle that touched something had lost the means to keep clear."""
    return what.kind in ADRIFT and not {what.vehicle, what.other}.isdisjoint(touch)


def names_of(fault: FaultReport) -> set[str]:
    """Ids of a fault, and of the other vehicle's fault with which it stops."""
    return {fault.id, fault.origin.id}


def called(
    fault: FaultReport | None, rows: Sequence[tuple[float, str]], names: Sequence[str],
    alike: Sequence[str] = (),
) -> tuple[str, str, bool | None]:  # fmt: skip
    """Id and words of what was said of a fault, and whether the id is right; see `Drilled`.

    Args:
        fault: that ended the run.
        rows: times and ids of the rows that held after the injection began.
        names: the right ones.
        alike: those that it cannot be told from: neither right nor wrong.
    """
    if fault is not None:
        rightly = not names_of(fault).isdisjoint(names)
        undecided = not rightly and fault.origin.id in alike
        return fault.origin.id, fault.words, None if undecided else rightly
    # healthy flights warn as well: such a row counts only as a name of the injected fault
    told = [row for _, row in sorted(rows) if row in names or row not in ROUTINE]
    if not told:
        return "", "", None
    rightly = told[0] in names
    return told[0], "a warning", None if not rightly and told[0] in alike else rightly


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


def deadline(response: Response, period: float, longest_brake: float) -> float:
    """Time from detection until every valve must be shut [s].

    Args:
        response: of the vehicle.
        period: of the jets [s].
        longest_brake: `flight.ending.brake_s` [s].
    """
    if response == Response.BRAKE:
        return longest_brake + BESIDE_BRAKE
    if response in (Response.COAST, Response.LAND):
        return period + BESIDE_PLANS  # a plan in flight
    return math.inf


def dead_within(period: float) -> float:
    """Time until the valves of a dead process must be shut: its last plan, and its life [s]."""
    return 2.0 * period + BESIDE_PLANS


def summarise(rig: str, cases: Sequence[Drilled]) -> Drill:
    """Summarise all cases in one row per kind."""
    rows = []
    for kind in dict.fromkeys(one.kind for one in cases):
        own = [one for one in cases if one.kind == kind]
        found = [one.detected_s for one in own if one.detected_s is not None]
        shut = [one.shut_s for one in own if one.shut_s is not None]
        responses = {one.response for one in own if one.response}
        words = ["not armed"] * any(one.refused for one in own)
        words += [one.words for one in sorted(responses)]
        rows.append(
            DrillRow(
                kind,
                len(own),
                sum(one.missed for one in own),
                sum(one.dormant for one in own),
                float(np.median(found)) if found else None,
                max(found, default=None),
                ", ".join(words),
                max(shut, default=None),
                max(one.travelled_m for one in own),
                sum(one.contacts for one in own),
                sum(one.adrift for one in own),
                sum(one.late for one in own),
                sum(one.contacts_after for one in own),
                sum(one.at_rest_s is None for one in own),
                sum(one.air == "on" for one in own),
                sum(not one.missed and not one.dormant and one.detected_s is None for one in own),
                sum(one.rightly is not None for one in own),
                sum(one.rightly is True for one in own),
                dict(Counter(one.called for one in own if one.called)),
                sum(one.alike for one in own),
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
