"""The drill on the twin: one injected fault per flight, and its outcome."""

import json
import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from multiprocessing import get_context

import numpy as np
from msgspec.structs import asdict, replace

from sim_twin.board import last_closing
from testbed.config import Experiment, find, load
from testbed.config.thresholds import vehicle_silent_s
from testbed.core.codes import FaultReport, Response
from testbed.core.fault_injection import Injection
from testbed.faults.catalogue import CATALOGUE
from testbed.faults.drill import (
    ASKED,
    OTHERS,
    Drilled,
    answered,
    called,
    cases_of,
    concerned,
    dead_within,
    deadline,
    draw,
    names_of,
    refused,
    without_means,
)
from testbed.flight.flown_tick import AnyHostTick, AnyTick
from testbed.flight.loop import host_fault
from testbed.flight.parameters import FlightParams
from testbed.metrics.afterwards import HARD
from testbed.rig.chain import fence_of
from testbed.rig.twin import TwinRig, make_twin

EXPERIMENTS = ("zhang2023_table", "zhang2023_table_wrench")
ROOM = 0.15  # clearance around a start [m]


class Notes:
    """Observer: records faults, responses and valve commands with times."""

    def __init__(self, silent_s: float = math.inf) -> None:
        self._silent_s = silent_s  # see loop.host_fault
        self.rows: list[tuple[float, str, str]] = []  # time, vehicle, row of the fault table
        self.responses: list[tuple[float, str, Response]] = []  # time, vehicle, response
        self.faults: list[tuple[float, str, FaultReport]] = []  # time, vehicle, fault
        self.asked: list[tuple[float, str, tuple[int, ...]]] = []  # time, vehicle, open times

    def vehicle(self, name: str, tick: AnyTick) -> None:
        """See `Observer`."""
        if tick.inputs.vitals.end:
            return
        out = tick.outputs
        self.rows += [(out.t, name, row) for row in out.faults]
        if out.response:
            self.responses.append((out.t, name, out.response))
        if out.fault:
            self.faults.append((out.t, name, out.fault))
        self.asked.append((out.t, name, out.command.on_us))

    def host(self, name: str, tick: AnyHostTick) -> None:
        """See `Observer`."""
        if fault := host_fault(name, tick, self._silent_s):
            self.faults.append((tick.inputs.t, name, fault))

    def done(self, t: float) -> None:
        """See `Observer`."""


def fly_case(experiment: Experiment, what: Injection, name: str = "") -> Drilled:
    """Fly one injection on the twin and judge it; `name` in the catalogue, if not its kind."""
    silent_s = vehicle_silent_s(experiment.table, experiment.flight)
    rig, notes, row = make_twin(experiment), Notes(silent_s), name or what.kind
    ending = rig.fly(notes)
    if rig.red:
        return refused(row, experiment.name, what, experiment.seed, rig.red)
    twin, plant = rig.twin, rig.twin.plant
    last = max(last_closing(board.pulses) for board in plant.boards.values())
    rest = rig.come_to_rest(ending, notes)
    assert rest is not None
    assert twin.injector is not None
    began = twin.injector.began()[0]
    after = [(t, name, one) for t, name, one in notes.responses if t >= began]
    own = [(t, one) for t, name, one in after if _concerned(what, name)]
    named, found = answered(_named(row, what, notes, began), own, began)
    response = max((one for _, one in own), default=Response.NONE)
    over = ending.fault is not None
    limits = {name: _limit(name, what, after, began, experiment.flight) for name in plant.names}
    touches = [
        touch for touch in plant.touches
        if began <= touch.t and (touch.t <= ending.t or touch.speed > HARD)
    ]  # fmt: skip
    helpless = [
        touch for touch in touches
        if without_means(what, (touch.vehicle, touch.other))
        or (touch.t > ending.t and _moves(experiment, touch.other))
    ]  # fmt: skip
    adrift = len(helpless)
    rows = [(t, one) for t, who, one in notes.rows if t >= began and _concerned(what, who)]
    told, said, rightly = called(ending.fault, rows, CATALOGUE[row].names, CATALOGUE[row].alike)
    early = tuple(sorted({fault.words for t, _, fault in notes.faults if t < began}))
    asked = sum(
        on[what.jet - 1] for t, name, on in notes.asked if name == what.vehicle and t >= began
    )
    return Drilled(
        row,
        experiment.name,
        what.vehicle,
        experiment.seed,
        began,
        named,
        found,
        response,
        last - began if over else None,
        _open_after(rig, limits) if over else 0,
        len(touches) - adrift,
        _travelled(rig, began),
        ending.fault,
        early,
        adrift,
        what.kind in ("stick_closed", "swap_jets", "reverse_jet")
        and found is None
        and asked < 1e6 * ASKED,
        sum(touch.t > ending.t and touch not in helpless for touch in touches),
        rest.at_rest_s,
        rest.air,
        called=told,
        said=said,
        rightly=rightly,
    )


def _concerned(what: Injection, name: str) -> bool:
    return concerned(what, name, silent=what.kind in OTHERS)


def _moves(experiment: Experiment, obstacle: str) -> bool:
    """Whether an obstacle moves, and so can hit vehicles that have stopped."""
    rock = experiment.obstacles.get(obstacle)
    return rock is not None and any(rock.velocity)


def _limit(
    name: str, what: Injection, after: Sequence[tuple[float, str, Response]], began: float,
    flight: FlightParams,
) -> float:  # fmt: skip
    """Deadline for closing a vehicle's valves, from its severest response or its death [s]."""
    if what.kind == "kill_process" and name == what.vehicle:
        return began + dead_within(flight.jet_period_s)
    own = [(t, one) for t, who, one in after if who == name]
    severest = max((one for _, one in own), default=Response.NONE)
    since = min((t for t, one in own if one == severest), default=0.0)
    return since + deadline(severest, flight.jet_period_s, flight.ending.brake_s)


def _named(row: str, what: Injection, notes: Notes, began: float) -> list[tuple[float, str]]:
    """Times and ids of what names or answers the fault, by the vehicles concerned."""
    names = *CATALOGUE[row].names, *CATALOGUE[row].answers
    right = [
        (t, found) for t, who, found in notes.rows
        if t >= began and found in names and _concerned(what, who)
    ]  # fmt: skip
    for t, _, fault in notes.faults:
        right += [(t, name) for name in names if name in names_of(fault) and t >= began]
    return right


def _open_after(rig: TwinRig, limits: Mapping[str, float]) -> int:
    """Number of valves with flow after their limit; a landed vehicle has none.

    The limit is that of the vehicle whose board the valves are connected to: one with the board of
    another cannot shut its own.
    """
    plant, count = rig.twin.plant, 0
    played = plant.played()
    for k in range(len(plant.names)):
        landed = 1e9 * plant.landed.get(k, math.inf)
        shut = np.minimum(played.down[k], landed)
        limit = limits[plant.names[plant.vehicle_of_board(k)]]
        late = (shut > 1e9 * limit) & (shut > played.up[k])
        count += int(late.any(axis=1).sum())
    return count


def _travelled(rig: TwinRig, began: float) -> float:
    """Largest distance of any vehicle from its position at `began` [m]."""
    truth = rig.track()
    since = truth.states[truth.t >= began, :, :2]
    if len(since) == 0:
        return 0.0
    return float(np.hypot(*(since - since[0]).transpose(2, 0, 1)).max())


@cache
def shipped(name: str) -> Experiment:
    """A shipped experiment, cached."""
    return load(find(name))


def with_random_starts(name: str, rng: np.random.Generator) -> Experiment:
    """The experiment with random starts, clear of obstacles and other vehicles."""
    experiment = shipped(name)
    taken = [(rock.position, rock.radius + ROOM) for rock in experiment.obstacles.values()]
    vehicles = {}
    for vehicle, setup in experiment.vehicles.items():
        half = np.array(fence_of(experiment, vehicle)) - ROOM
        while True:
            x, y = (half * rng.uniform(-1.0, 1.0, 2)).tolist()
            if all(np.hypot(x - px, y - py) > reach for (px, py), reach in taken):
                break
        taken.append(((x, y), 2.0 * setup.model.radius + ROOM))
        start = (x, y, float(rng.uniform(-np.pi, np.pi)))
        vehicles[vehicle] = replace(setup, start=start)
    return replace(experiment, vehicles=vehicles)


def case(number: int, seed: int, names: Sequence[str] = EXPERIMENTS) -> Drilled:
    """Fly case `number` of a drill: kinds and experiments alternate, the rest is random."""
    fleet = max(len(shipped(name).vehicles) for name in names)
    kinds = cases_of("twin", fleet)
    rng = np.random.default_rng([seed, number])
    name = names[(number // len(kinds)) % len(names)]
    return drawn(kinds[number % len(kinds)], name, rng)


def drawn(kind: str, name: str, rng: np.random.Generator) -> Drilled:
    """Fly a random case of this row of the catalogue in this experiment."""
    begun = with_random_starts(name, rng)
    jets = min(len(setup.model.jets) for setup in begun.vehicles.values())
    what = draw(kind, list(begun.vehicles), jets, begun.flight.jet_period_s, rng)
    duration = (what.at_s or 0.0) + CATALOGUE[kind].flown_s
    experiment = replace(begun, seed=int(rng.integers(2**31)), duration_s=duration, inject=[what])
    return replace(fly_case(experiment, what, kind), again=command(experiment, name, what))


def command(experiment: Experiment, name: str, what: Injection) -> str:
    """What flies a case again, as far as the response of the fault table."""
    words = [
        f"vehicles.{one}.start=[{', '.join(map(repr, setup.start))}]"
        for one, setup in experiment.vehicles.items()
    ]
    fields = {key: value for key, value in asdict(what).items() if value not in (None, "")}
    inject = ", ".join(f"{key} = {json.dumps(value)}" for key, value in fields.items())
    words += [f"duration_s={experiment.duration_s!r}", f"inject=[{{{inject}}}]"]
    return shlex.join(["testbed", "run", name, *words, "--seed", str(experiment.seed)])


def drill_twin(
    injections: int, seed: int, jobs: int, names: Sequence[str] = EXPERIMENTS
) -> Iterator[Drilled]:
    """Fly all cases on the twin; yields the judged cases in order."""
    yield case(0, seed, names)  # compiles before the worker processes start
    fly = partial(case, seed=seed, names=names)
    # forked workers share the compiled code
    with ProcessPoolExecutor(jobs, mp_context=get_context("fork")) as pool:
        yield from pool.map(fly, range(1, injections), chunksize=4)
