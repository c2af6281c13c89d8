"""Does a vehicle with a bad jet name it and fly on with the others? On the twin.

    python benchmarks/jets_left.py [--seeds 20] [--faults shut weak open] [--jobs 2]
                                   [--vehicles generic_8jet atmos freeflyer uky spot_red lab]

Each jet of six vehicles sticks shut, sticks open, or loses 30 % of its thrust, while the vehicle
flies 1.4 m, turns by a radian and holds, with default gains. The fault table is the shipped one,
but `reconfigure` for a jet that is stuck open, too. Counted are flights at whose end the bad jet
and no other is named; the time to that from the fault (stuck open) or from the first command of the
jet after it; and flights that hold: within 0.1 m and 0.1 rad in the last 10 s. Flights in which the
jet was commanded for less than 1.5 s in all and nothing was named are not counted: it was not used.
"""

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace
from reach import NEAR, reach

from testbed.config import Experiment
from testbed.core.fault_injection import Injection
from testbed.core.se2 import wrap
from testbed.faults.drill import ASKED
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin

VEHICLES = ("generic_8jet", "atmos", "freeflyer", "uky", "spot_red", "lab")
WEAK = 0.7  # of its thrust
LASTS_S, HOLDS_S = 75.0, 10.0
WHEN = (2.0, 12.0)  # [s]: on the way and after it
FIRST_HOURS = {"mass": 20.0, "inertia": 0.4, "radius": 0.25}
SLOW = {"open_delay_s": 0.025, "close_delay_s": 0.015, "min_on_s": 0.02}
ARM, LEVER = 0.18, 0.11  # [m] of its jets


class Case(NamedTuple):
    """A flight with a fault."""

    vehicle: str
    kind: str  # "shut", "open", "weak" or "none"
    jet: int  # from 0
    seed: int


class Found(NamedTuple):
    """What came of it."""

    case: Case
    named: tuple[int, ...]  # jets, at the end
    before: tuple[int, ...]  # others that were named on the way, and taken back
    after_s: float  # from the fault to the name of the right jet
    used_s: float  # from the first command of the jet after the fault, to the same
    asked_s: float  # for which the jet was commanded after the fault, until it was named
    holds: bool
    words: str  # of the fault that ended the flight

    @property
    def used(self) -> bool:
        """Whether the jet was used, or something was named."""
        return self.case.kind == "open" or bool(self.named or self.words) or self.asked_s > ASKED

    @property
    def right(self) -> bool:
        """Whether the bad jet and no other was named."""
        return self.named == (self.case.jet,)


class Watch(NullObserver):
    """Notes when jets are commanded and named."""

    def __init__(self, rig, case: Case, at_s: float) -> None:
        self.rig, self.case, self.at_s = rig, case, at_s
        self.asked_s, self.first, self.named, self.others = 0.0, 0.0, {}, set()

    def vehicle(self, name, tick) -> None:
        """See `Observer`."""
        t, on = tick.outputs.t, tick.outputs.command.on_us[self.case.jet]
        if t >= self.at_s and on and self.case.jet not in self.named:
            self.first = self.first or t
            self.asked_s += 1e-6 * on
        jets = self.rig.vehicles[0].jets
        self.named = {j: jet.named_s for j, jet in enumerate(jets) if jet.named_s is not None}
        self.others |= self.named.keys() - {self.case.jet}


def experiment_of(case: Case) -> tuple[Experiment, float]:
    """The flight, and the time of the fault [s]."""
    experiment = lab() if case.vehicle == "lab" else reach(case.vehicle)
    rng = np.random.default_rng([case.seed, case.jet])
    at_s = round(float(rng.uniform(*WHEN)), 3)
    faults = dict(experiment.faults)
    row = faults["valve_stuck_open"]
    faults["valve_stuck_open"] = replace(row, response="reconfigure", otherwise="land")
    kinds = {"shut": "stick_closed", "open": "stick_open", "weak": "weak_jet"}
    inject = []
    if case.kind in kinds:
        share = WEAK if case.kind == "weak" else None
        bad = Injection(kinds[case.kind], "sat1", at_s=at_s, jet=case.jet + 1, value=share)
        inject = [bad]
    return replace(
        experiment, duration_s=LASTS_S, seed=case.seed, faults=faults, inject=inject
    ), at_s


def lab() -> Experiment:
    """A lab's own vehicle: 20 kg, eight jets of 0.25 N elsewhere than shipped, slow valves."""
    experiment = reach("generic_8jet")
    setup = experiment.vehicles["sat1"]
    model = setup.model
    jets = []
    for jet in model.jets:
        x, y = (float(np.sign(p)) * (ARM if abs(p) > 0.1 else LEVER) for p in jet.position)
        jets.append(replace(jet, position=(x, y), thrust=0.25))
    model = replace(model, jets=jets, valve=replace(model.valve, **SLOW), **FIRST_HOURS)
    return replace(experiment, vehicles={"sat1": replace(setup, model=model)})


def fly(case: Case) -> Found:
    """Fly a case and judge it."""
    experiment, at_s = experiment_of(case)
    rig = make_twin(experiment)
    watch = Watch(rig, case, at_s)
    ending = rig.fly(watch)
    track, goal = rig.track(), experiment.vehicles["sat1"].goal
    own = track.states[track.t > LASTS_S - HOLDS_S, 0]
    holds = ending.fault is None and bool(
        np.hypot(own[:, 0] - goal[0], own[:, 1] - goal[1]).max() < NEAR
        and max(abs(wrap(theta - goal[2])) for theta in own[:, 2]) < NEAR
    )
    words = "" if ending.fault is None else ending.fault.words
    at, first, named = watch.named.get(case.jet, np.inf), watch.first, tuple(watch.named)
    used = at - max(at_s, first) if first else at - at_s
    before = tuple(sorted(watch.others - set(named)))
    return Found(case, named, before, at - at_s, used, watch.asked_s, holds, words)


def said(one: Found) -> Found:
    """Print a case that went wrong."""
    if one.case.kind != "none" and one.used and not (one.right and one.holds):
        print(one, flush=True)
    return one


def report(found: list[Found]) -> bool:
    """Print a line for each vehicle and fault; whether all limits are met."""
    groups: dict[tuple[str, str], list[Found]] = {}
    for one in found:
        groups.setdefault((one.case.vehicle, one.case.kind), []).append(one)
    good = True
    for (vehicle, kind), ones in groups.items():
        used = [one for one in ones if one.used]
        named = [one for one in used if one.right]
        others = sum(bool(one.before) for one in used)
        times = [one.after_s if kind == "open" else one.used_s for one in named] or [np.nan]
        holds = sum(one.holds for one in used)
        ended = sum(bool(one.words) for one in used)
        print(
            f"{vehicle:12} {kind:5} {len(ones)} flights, {len(used)} used the jet:"
            f" {len(named)} named right, {others} after another one;"
            f" median {np.median(times):.2f} s, last {max(times):.1f} s;"
            f" {holds} held, {ended} ended by a fault"
        )
        few = len(used) or 1
        good &= kind == "none" or (len(named) >= 0.98 * few and np.median(times) <= 2.0)
        good &= kind != "shut" or holds >= 0.95 * few
    return bool(good)


def main() -> int:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--vehicles", nargs="*", default=VEHICLES)
    parser.add_argument("--faults", nargs="*", default=["shut", "weak", "open"])
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    cases = [
        Case(vehicle, kind, jet, seed)
        for vehicle in options.vehicles
        for kind in options.faults
        for jet in range(8)
        for seed in range(options.first, options.first + options.seeds)
    ]
    if options.jobs == 1:
        found = list(map(said, map(fly, cases)))
    else:
        with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
            found = list(map(said, pool.map(fly, cases, chunksize=4)))
    return 0 if report(found) else 1


if __name__ == "__main__":
    sys.exit(main())
