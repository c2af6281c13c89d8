"""Do healthy vehicles fly on, and are valves that do not obey named right? On the twin.

    python benchmarks/valve_faults.py [--slow 100] [--odd 10] [--open 16] [--leaks 60] [--shut 16]

--slow   healthy flights of `hold` over a grid of opening delays of 10-35 ms and shortest pulses of
         10-40 ms
--odd    healthy flights of each vehicle that is not quite what its file says: thrust spread 15 % on
         a table ten times as steep, and a centre of mass that is 20 mm off without a word
--open   a jet stuck open, so often on each of five vehicles; the weakest has 0.2 N for 16 kg
--leaks  a jet that lets 10-60 % of its flow through when it is shut
--shut   a jet stuck shut, with which it flies on; one that is not asked for is counted apart

Prints the cases that went wrong, then counts. The exit code is 1 if any case went wrong.
"""

import argparse
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from testbed.core.codes import Response
from testbed.core.fault_injection import Injection
from testbed.faults.drill import ASKED
from testbed.rig.twin import make_twin
from testbed.run.drill import Notes, shipped

VEHICLES = {  # thrust [N], mass [kg], inertia [kg m^2]
    "generic_8jet": (0.6, 12.5, 0.20),
    "15 kg": (0.5, 15.0, 0.24),
    "0.2 N, 16 kg": (0.2, 16.0, 0.18),
    "1.5 N, 17.8 kg": (1.5, 17.8, 0.315),
    "0.45 N, 23.1 kg": (0.45, 23.1, 0.324),
}
NEEDED_S = {"slow": 120.0, "odd": 120.0, "open": 8.0, "leaks": 25.0, "shut": 60.0}
OPENS_S, SHORTEST_S = (0.010, 0.035), (0.010, 0.040)
LEAKS = (0.1, 0.6)
OFF_BALANCE = 0.02  # [m]
STEEP = 10.0
WHEN = (2.0, 20.0)  # [s]


class Case(NamedTuple):
    """A flight with one valve fault."""

    kind: str
    what: str
    number: int
    many: int  # of its kind


class Found(NamedTuple):
    """Result of a case."""

    case: Case
    verdict: str  # "well", "wrong", "dormant", or "other": ended by a fault that is not of valves
    after_s: float  # from the fault to its name
    words: str


def with_model(experiment, change):
    """The experiment with other vehicles."""
    setups = {n: replace(s, model=change(s.model)) for n, s in experiment.vehicles.items()}
    return replace(experiment, vehicles=setups)


def scaled(name):
    """A change of the shipped vehicle into this one."""
    thrust, mass, inertia = VEHICLES[name]

    def change(model):
        jets = [replace(jet, thrust=thrust) for jet in model.jets]
        return replace(model, jets=jets, mass=mass, inertia=inertia)

    return change


def slow(case):
    """Valves somewhere on the grid."""
    side = int(np.ceil(np.sqrt(case.many)))
    row, column = np.array(divmod(case.number, side)) / max(1, side - 1)
    opens = float(np.interp(row, (0.0, 1.0), OPENS_S))
    shortest = float(np.interp(column, (0.0, 1.0), SHORTEST_S))

    def change(model):
        valve = replace(model.valve, open_delay_s=opens, min_on_s=shortest)
        return replace(model, valve=valve)

    return with_model(shipped("hold"), change)


def steep(experiment):
    """The experiment on a table that slopes ten times as much, with jets of 15 % spread."""
    tilt = experiment.table.tilt
    rows = [[(STEEP * ax, STEEP * ay) for ax, ay in row] for row in tilt.map]
    uniform = (STEEP * tilt.uniform[0], STEEP * tilt.uniform[1])
    table = replace(experiment.table, tilt=replace(tilt, uniform=uniform, map=rows))
    spread = lambda model: replace(model, tolerance=replace(model.tolerance, thrust=0.15))  # noqa: E731
    return with_model(replace(experiment, table=table), spread)


def prepared(case, rng):
    """The experiment of a case, and the fault in it if there is one."""
    jet = int(rng.integers(1, 9))
    at_s = round(float(rng.uniform(*WHEN)), 4)
    match case.kind:
        case "slow":
            return slow(case), None
        case "odd":
            name, how = case.what.split(", ")
            return (steep(shipped(name)) if how == "steep and unequal" else shipped(name)), None
        case "open":
            fault = Injection("stick_open", "sat1", at_s=at_s, jet=jet)
            return with_model(shipped("hold"), scaled(case.what)), fault
        case "leaks":
            share = round(float(np.interp(case.number, (0, max(1, case.many - 1)), LEAKS)), 3)
            fault = Injection("leak_valve", "sat1", at_s=at_s, jet=jet, value=share)
            return shipped("hold"), fault
        case _:
            fault = Injection("stick_closed", "sat1", at_s=at_s, jet=jet)
            return shipped(("hold", "zhang2023_table")[case.number % 2]), fault


def fly(case):
    """Fly a case and judge it."""
    rng = np.random.default_rng([list(NEEDED_S).index(case.kind), case.number])
    experiment, fault = prepared(case, rng)
    lasts = NEEDED_S[case.kind] + (fault.at_s if fault else 0.0)
    experiment = replace(
        experiment, seed=1000 + case.number, duration_s=lasts, inject=[fault] if fault else []
    )
    rig, notes = make_twin(experiment), Notes()
    if "balance" in case.what:
        way = rng.uniform(0.0, 2.0 * np.pi)
        rig.twin.plant.parameters.com[:] += OFF_BALANCE * np.array([np.cos(way), np.sin(way)])
    ending = rig.fly(notes)
    report = ending.fault
    words = "" if report is None else report.words
    if fault is None:
        about_valves = "wrong" if report and report.id.startswith("valve_") else "other"
        return Found(case, about_valves if words else "well", ending.t, words)
    asked = sum(on[fault.jet - 1] for t, who, on in notes.asked if who == "sat1" and t > fault.at_s)
    bad = {k: one.named_s for k, one in enumerate(rig.jets("sat1"), 1) if one.named_s is not None}
    if not words and case.kind == "shut" and not bad and asked < 1e6 * ASKED:
        return Found(case, "dormant", 0.0, words)
    if not words and case.kind == "shut":  # flown on
        right = list(bad) == [fault.jet]
        after = bad.get(fault.jet, ending.t) - fault.at_s
        return Found(case, "well" if right else "wrong", after, f"{fault}: named {bad}")
    right = ending.t > fault.at_s and named_right(case.kind, fault.jet, report, notes)
    return Found(case, "well" if right else "wrong", ending.t - fault.at_s, f"{fault}: {words}")


def named_right(kind, jet, report, notes):
    """Whether the report is of this jet, and a valve that cannot be shut has made it land."""
    rows = {
        "open": ("valve_stuck_open",),
        "leaks": ("valve_leaks", "valve_leaks_or_weak", "valve_stuck_open"),
        "shut": ("valve_stuck_closed", "valve_leaks_or_weak"),
    }[kind]
    landed = any(response == Response.LAND for _, _, response in notes.responses)
    named = report is not None and report.id in rows and f"jet {jet} " in report.text
    return named and (kind == "shut" or landed)


def cases_of(options):
    """The cases that the options select."""
    whats = {
        "slow": ["valves"],
        "odd": [
            f"{name}, {how}"
            for name in ("hold", "zhang2023_table")
            for how in ("steep and unequal", "off balance")
        ],
        "open": list(VEHICLES),
        "leaks": ["generic_8jet"],
        "shut": ["hold and zhang2023_table"],
    }
    for kind, names in whats.items():
        many = getattr(options, kind)
        for what in names:
            yield from (Case(kind, what, number, many) for number in range(many))


def main():
    """Fly, print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    for kind in NEEDED_S:
        parser.add_argument(f"--{kind}", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    cases = list(cases_of(options))
    if options.jobs == 1:
        found = [fly(case) for case in cases]
    else:
        with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
            found = list(pool.map(fly, cases, chunksize=4))
    groups = {}
    for one in found:
        groups.setdefault((one.case.kind, one.case.what), []).append(one)
        if one.verdict in ("wrong", "other"):
            print(one)
    for (kind, what), ones in groups.items():
        count, healthy = Counter(one.verdict for one in ones), kind in ("slow", "odd")
        good = "flew on" if healthy else "named right"
        line = f"{kind}, {what}: {len(ones)} flights, {count['well']} {good}"
        if count["dormant"]:
            line += f", {count['dormant']} not asked for"
        if count["other"]:
            line += f", {count['other']} ended by a fault that is not of valves"
        after = [one.after_s for one in ones if one.verdict == "well"]
        if after and not healthy:
            line += f", after {np.median(after):.2f} s, at most {max(after):.2f} s"
        print(line)
    return int(any(one.verdict == "wrong" for one in found))


if __name__ == "__main__":
    sys.exit(main())
