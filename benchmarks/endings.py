"""However a flight ends, its vehicles must stand a minute later: no contact, at rest, air off.

    python benchmarks/endings.py N [--seed S] [--rig twin|bench] [--first K]

Flies N flights that start anywhere on the table. Their ends take turns: as planned, a stop at a
random instant, a stop that is repeated within a second, a hold after the planned end, ended by a
stop or by its time, and every fault of the drill.

On the twin five experiments fly on the shipped table and on a rough one (steeper, bumpy), with the
first vehicle anywhere or at the edge. On the bench the boards' time stamps say when the last valve
closed, and the boards whether they are SAFE; processes of vehicles and of the host are killed.
"""

import argparse
import sys
from collections.abc import Callable, Iterable
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import tomli_w
from msgspec import Struct
from msgspec.structs import replace

from testbed.config import Experiment, dump
from testbed.faults.catalogue import CATALOGUE
from testbed.faults.drill import cases_of, draw
from testbed.metrics.afterwards import After
from testbed.rig.chain import fence_of
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin, warm_up
from testbed.rig.wired.host import WireRig
from testbed.rig.wired.table_report import TableReport
from testbed.run import drill_on_wires
from testbed.run.drill import ROOM, with_random_starts
from testbed.run.drill_on_wires import DrillError

EXPERIMENTS = (
    "zhang2023_table", "zhang2023_table_wrench", "xue2021_table_static", "xue2022_table",
    "xue2024_table_constant",
)  # fmt: skip
WHEN = (2.0, 30.0)  # [s] of an end as planned, and of a stop
AGAIN = 1.0  # [s] the second stop comes within
HOLD_S = 20.0  # [s]
TRIES = 3  # of a flight on the bench
STEEP = 0.005  # [m/s^2] slope of the rough table: what the vehicle files allow
BUMPS = 0.002  # [m/s^2] standard deviation of its map
ENDS = ("planned", "stop", "stop twice", "hold, stop", "hold, time")
FAULTS = [name for name in cases_of("twin", 2) if not CATALOGUE[name].at_start]
ON_BENCH = (
    *ENDS[:4], "kill_process", "stop_process", "cut_serial", "kill_host", "drop_mocap",
    "stick_open",
)  # fmt: skip


class Flown(Struct, frozen=True):
    """How one flight ended, and the minute after."""

    end: str  # one of ENDS, or a kind of injection
    where: tuple[str, ...]  # experiment, table, place
    after: After
    named: str
    shut_s: float | None = None  # the boards' last closing after the end, or after the fault [s]
    safe: bool = True  # every board is in SAFE

    @property
    def stands(self) -> bool:
        """Whether it ended as promised."""
        after = self.after
        return (after.contacts, after.air) == (0, "off") and after.at_rest_s is not None


def rough(experiment: Experiment, rng: np.random.Generator) -> Experiment:
    """The experiment on a steep and bumpy table."""
    angle, table = rng.uniform(-np.pi, np.pi), experiment.table
    slope = (STEEP * np.array([np.cos(angle), np.sin(angle)])).tolist()
    bumps = (BUMPS * rng.standard_normal((6, 6, 2))).tolist()
    tilt = replace(table.tilt, uniform=tuple(slope), map=bumps)
    return replace(experiment, table=replace(table, tilt=tilt))


def at_edge(experiment: Experiment, rng: np.random.Generator) -> Experiment:
    """The experiment with its first vehicle close to the nearest edge, if there is room."""
    vehicles = dict(experiment.vehicles)
    name, setup = next(iter(vehicles.items()))
    x, y, theta = setup.start
    half = fence_of(experiment, name)
    if half[0] - abs(x) < half[1] - abs(y):
        x = float(np.copysign(half[0] - rng.uniform(0.0, ROOM), x))
    else:
        y = float(np.copysign(half[1] - rng.uniform(0.0, ROOM), y))
    radius = setup.model.radius
    for other in list(vehicles.values())[1:]:
        if np.hypot(other.start[0] - x, other.start[1] - y) < radius + other.model.radius + ROOM:
            return experiment  # another vehicle is there already
    vehicles[name] = replace(setup, start=(x, y, theta))
    return replace(experiment, vehicles=vehicles)


def planned(
    end: str, name: str, rng: np.random.Generator
) -> tuple[Experiment, Callable[[float], int]]:
    """An experiment that ends in this way, and the number of stops at a time."""
    experiment = replace(with_random_starts(name, rng), seed=int(rng.integers(2**31)))
    at = float(rng.uniform(*WHEN))
    first = second = inf
    if end not in ENDS:
        jets = min(len(setup.model.jets) for setup in experiment.vehicles.values())
        what = draw(end, list(experiment.vehicles), jets, experiment.flight.jet_period_s, rng)
        lasts = (what.at_s or 0.0) + CATALOGUE[end].flown_s
        experiment = replace(experiment, duration_s=round(lasts, 1), inject=[what])
    elif end.startswith("stop"):
        first = at
        second = at + float(rng.uniform(0.0, AGAIN)) if end == "stop twice" else inf
    else:
        experiment = replace(experiment, duration_s=round(at, 1))
        if end.startswith("hold"):
            ending = replace(experiment.flight.ending, after="hold", hold_s=HOLD_S)
            experiment = replace(experiment, flight=replace(experiment.flight, ending=ending))
            first = at + float(rng.uniform(0.0, HOLD_S)) if end == "hold, stop" else inf
    return experiment, lambda now: int(now >= first) + int(now >= second)


def on_twin(number: int, seed: int) -> Flown:
    """Flight `number`: ends and experiments take turns, the rest is drawn."""
    rng, ends = np.random.default_rng([seed, number]), (*ENDS, *FAULTS)
    end, name = ends[number % len(ends)], EXPERIMENTS[number // len(ends) % len(EXPERIMENTS)]
    experiment, stops = planned(end, name, rng)
    table, place = str(rng.choice(["marble", "rough"])), str(rng.choice(["anywhere", "edge"]))
    experiment = rough(experiment, rng) if table == "rough" else experiment
    experiment = at_edge(experiment, rng) if place == "edge" else experiment
    rig = make_twin(experiment)
    ending = rig.fly(NullObserver(), lambda: stops(rig.now))
    after = rig.come_to_rest(ending, NullObserver(), lambda: stops(rig.now))
    where = (name, table, place)
    if after is None:
        return Flown(
            end, where, After(None, None, "on", {}), "; ".join(one.words for one in rig.red)
        )
    fault = ending.fault or after.fault
    return Flown(end, where, after, fault.words if fault else "")


def on_bench(number: int, seed: int) -> Flown:
    """Flight `number` over wires, with the boards' time stamps."""
    rng, end = np.random.default_rng([seed, number]), ON_BENCH[number % len(ON_BENCH)]
    where = (drill_on_wires.EXPERIMENT, "marble", "anywhere")
    experiment, stops = planned(end, drill_on_wires.EXPERIMENT, rng)
    names = list(experiment.vehicles)
    if end in ENDS:
        warm_up(experiment)
        rig = WireRig(experiment, bench=True)
        ending = rig.fly(NullObserver(), lambda: stops(rig.now))
        after, report, clock = (
            rig.come_to_rest(ending, NullObserver()),
            rig.results.report,
            rig.results.clock,
        )
        if after is None:
            raise DrillError(f"the flight did not begin: {rig.red or ending}")
        assert report is not None
        assert clock is not None
        named = ending.fault.words if ending.fault else ""
        ended_ns = clock.epoch_ns + round(1e9 * ending.t)
    else:
        with TemporaryDirectory() as folder:
            file = Path(folder) / "experiment.toml"
            file.write_text(tomli_w.dumps(dump(experiment)))
            flown = drill_on_wires.fly(file, Path(folder), names, experiment.duration_s)
        if flown.red:
            raise DrillError(f"the flight did not begin: {flown.red}")
        report, fault = flown.report, flown.fault
        at = experiment.inject[0].at_s or 0.0
        ends = [at, *(one.t for one in flown.ended.values())]
        late = 1e-9 * ((report.released_ns or 0) - flown.epoch_ns)
        after = report.after(names, max(ends) - late)
        named = fault.words if fault else ""
        ended_ns = flown.epoch_ns + round(1e9 * at)
    safe = all(state == "SAFE" for state, _ in report.left_as.values())
    shut_s = max(0.0, last_closing(report) - 1e-9 * ended_ns)
    return Flown(end, where, after, named, shut_s, safe)


def begun(number: int, seed: int) -> Flown:
    """The same; a flight that does not begin, on a machine that is too busy, is flown again."""
    for _ in range(TRIES):
        try:
            return on_bench(number, seed)
        except DrillError as error:
            print(f"flight {number}: {error}", flush=True)
    return on_bench(number, seed)


def last_closing(report: TableReport) -> float:
    """When a board closed a valve for the last time, on the monotonic clock [s]."""
    closed = [at_us for edges in report.edges.values() for at_us, mask in edges if mask == 0]
    return 1e-6 * max(closed, default=0)


def seconds(value: float | None) -> str:
    """A time, or a dash."""
    return "-" if value is None else f"{value:.2f}"


def row(name: str, flown: Iterable[Flown]) -> str:
    """One line of the table."""
    chosen = list(flown)
    known = [one.after.at_rest_s for one in chosen if one.after.at_rest_s is not None]
    contacts = sum(one.after.contacts or 0 for one in chosen)
    off = sum(one.after.air == "off" for one in chosen)
    worst = max(known) if known and len(known) == len(chosen) else None
    shut = [one.shut_s for one in chosen if one.shut_s is not None]
    cells = [name, len(chosen), contacts, len(known), off]
    cells += [seconds(float(np.median(known)) if known else None), seconds(worst)]
    if shut:
        cells += [sum(one.safe for one in chosen), seconds(max(shut))]
    return "| " + " | ".join(map(str, cells)) + " |"


def tables(flown: list[Flown]) -> list[str]:
    """The table by kind of end, and by place."""
    head = "| end | flights | contacts | at rest | air off | to rest, median [s] | worst [s] |"
    if any(one.shut_s is not None for one in flown):
        head += " boards SAFE | last closing, worst [s] |"
    lines = [head, "|" + "---|" * (head.count("|") - 1)]
    ends = dict.fromkeys(one.end for one in flown)
    lines += [row(end, (one for one in flown if one.end == end)) for end in ends]
    places = dict.fromkeys(part for one in flown for part in one.where)
    lines += [row(f"({part})", (one for one in flown if part in one.where)) for part in places]
    return [*lines, row("all", flown)]


def main() -> int:
    """Fly, print, and judge."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("count", type=int)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--rig", choices=["twin", "bench"], default="twin")
    options = parser.parse_args()
    fly = on_twin if options.rig == "twin" else begun
    flown = []
    for number in range(options.first, options.first + options.count):
        one = fly(number, options.seed)
        flown.append(one)
        if not one.stands:
            print(f"flight {number}: {one}", flush=True)
        elif options.rig == "bench":
            print(f"flight {number}: {one.end}: {one.named or 'no fault'}", flush=True)
    print("\n".join(tables(flown)))
    return 0 if all(one.stands and one.safe for one in flown) else 1


if __name__ == "__main__":
    sys.exit(main())
