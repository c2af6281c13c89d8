"""Adversarial laws against the safety filter, on the twin with cameras, estimator, radio and jets.

    python benchmarks/filter.py --scenarios N [--seed S] [--first K]
    python benchmarks/filter.py --show K [--seed S]      flies one again, with log and report

Two to five vehicles fly one of the laws of benchmarks/adversary.py among random obstacles, in every
other scenario with obstacles that move at up to 0.1 m/s. Counted are contacts in flight with
vehicles and with the solid bodies of obstacles, and vehicles that left the table.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from adversary import Kind
from msgspec import Struct
from msgspec.structs import replace

import testbed
from controllers.own_law import OwnLawParams
from testbed.config import Deploy, Experiment, VehicleSetup
from testbed.core.table import Obstacle
from testbed.flight.guidance import GuidanceParams
from testbed.metrics.run_metrics import Criteria, obstacle_distances
from testbed.rig.chain import fence_of
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin

LAW = f"{Path(__file__).with_name('adversary.py')}:Adversary"
KINDS: tuple[Kind, ...] = ("threat", "bang", "chase", "gap", "random")
LASTS = 60.0  # [s]
SIDE = (4.5, 6.0)  # of the table [m]
RADIUS = (0.4, 0.8)  # danger radius of an obstacle [m]
BODY = 0.05  # between the danger radius and a contact [m]
SPEED = (0.02, 0.1)  # of a moving obstacle [m/s]
OUTSIDE = 1.0  # a moving obstacle starts at most this far outside the table [m]
ROOM = 0.15  # clearance around a start [m]
SOON = 5.0  # a moving obstacle is not at a start within this time [s]
HEAD = "| law, obstacles | scenarios | contacts | edge exits | in a danger radius | mm | faults |"


class Flown(Struct, frozen=True):
    """How one scenario ended."""

    number: int
    kind: str
    moving: bool
    contacts: tuple[str, ...]  # with vehicles and solid bodies, as text
    exits: tuple[str, ...]  # over the edge
    inside: float  # deepest place in a danger radius, 0: none [m]
    fault: str  # that ended the flight; empty: none

    @property
    def held(self) -> bool:
        """Whether nothing was touched and no vehicle left the table."""
        return not self.contacts and not self.exits


def obstacle(rng: np.random.Generator, half: float, moving: bool) -> Obstacle:
    """A random obstacle; a moving one heads for a random place of the table."""
    radius = float(rng.uniform(*RADIUS))
    reach = half + OUTSIDE * moving
    place, aim = rng.uniform(-reach, reach, 2), rng.uniform(-half, half, 2)
    way = (aim - place) / np.hypot(*(aim - place))
    velocity = (rng.uniform(*SPEED) * way).tolist() if moving else (0.0, 0.0)
    body = radius - VEHICLE.radius - BODY
    return Obstacle(tuple(place.tolist()), radius, body, tuple(velocity))


def clear(place: np.ndarray, rock: Obstacle) -> bool:
    """Whether a vehicle may start there."""
    p, v = np.array(rock.position), np.array(rock.velocity)
    along = float(np.clip((place - p) @ v / max(v @ v, 1e-12), 0.0, SOON))
    return bool(np.hypot(*(place - p - along * v)) > rock.radius + ROOM)


def scenario(number: int, seed: int) -> Experiment:
    """Scenario `number`: laws, and still and moving obstacles take turns, the rest is drawn."""
    rng = np.random.default_rng([seed, number])
    kind, moving = KINDS[number % len(KINDS)], number // len(KINDS) % 2 == 1
    side = float(rng.uniform(*SIDE))
    count, rocks = int(rng.integers(2, 6)), int(rng.integers(1, 4))
    obstacles = {
        f"o{k + 1}": obstacle(rng, side / 2, moving and (k == 0 or rng.random() < 0.5))
        for k in range(rocks)
    }
    table = replace(HOLD.table, size=(side, side))
    experiment = replace(HOLD, table=table)
    half = np.array(fence_of(experiment, "sat1")) - ROOM
    places: list[np.ndarray] = []
    while len(places) < count:
        place = half * rng.uniform(-1.0, 1.0, 2)
        apart = all(np.hypot(*(place - other)) > 2.0 * VEHICLE.radius + ROOM for other in places)
        if apart and all(clear(place, rock) for rock in obstacles.values()):
            places.append(place)
    starts = [(*place.tolist(), float(rng.uniform(-np.pi, np.pi))) for place in places]
    # these laws have no goal; a goal elsewhere could be refused when the run is replayed
    vehicles = {
        f"sat{k + 1}": VehicleSetup(VEHICLE, start, start) for k, start in enumerate(starts)
    }
    law = {"kind": kind, "seed": int(rng.integers(2**31)), "half": (side / 2, side / 2)}
    return replace(
        experiment,
        name=f"filter_{seed}_{number}",
        description=f"{kind}, {'moving' if moving else 'still'} obstacles",
        duration_s=LASTS,
        seed=int(rng.integers(2**31)),
        vehicles=vehicles,
        obstacles=obstacles,
        controller=OwnLawParams(LAW, law),
        guidance=GuidanceParams(mode="wrench"),
        deploy=Deploy(law="vehicle"),
        criteria=Criteria(),
    )


def fly(number: int, seed: int) -> Flown:
    """Fly a scenario on the twin."""
    experiment = scenario(number, seed)
    rig = make_twin(experiment)
    ending = rig.fly(NullObserver())
    edges = ("edge",)
    touches = [touch for touch in rig.touches if touch.t <= ending.t]
    texts = [
        f"{one.vehicle} {one.other} at {one.t:.1f} s with {100.0 * one.speed:.1f} cm/s"
        for one in touches
    ]
    out = tuple(t for t, one in zip(texts, touches, strict=True) if one.other.endswith(edges))
    track = rig.track()
    distances = [
        experiment.obstacles[name].radius - far
        for k in range(len(experiment.vehicles))
        for name, far in obstacle_distances(track, k, experiment.obstacles).items()
    ]
    return Flown(
        number,
        KINDS[number % len(KINDS)],
        number // len(KINDS) % 2 == 1,
        tuple(t for t in texts if t not in out),
        out,
        max(0.0, *distances),
        ending.fault.words if ending.fault else "",
    )


def row(name: str, flown: Iterable[Flown]) -> str:
    """One line of the table."""
    chosen = list(flown)
    cells = [
        name, len(chosen), sum(len(one.contacts) for one in chosen),
        sum(len(one.exits) for one in chosen), sum(one.inside > 0.0 for one in chosen),
        f"{1e3 * max((one.inside for one in chosen), default=0.0):.0f}",
        sum(bool(one.fault) for one in chosen),
    ]  # fmt: skip
    return "| " + " | ".join(map(str, cells)) + " |"


def main() -> int:
    """Fly, print, and judge."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scenarios", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--show", type=int)
    options = parser.parse_args()
    if options.show is not None:
        folder = f"runs/filter_{options.seed}_{options.show}"
        print(testbed.fly(scenario(options.show, options.seed), log=folder))
        print(f"testbed report {folder}")
        return 0
    flown = []
    for number in range(options.first, options.first + options.scenarios):
        one = fly(number, options.seed)
        flown.append(one)
        if not one.held or one.inside > 0.0 or one.fault:
            print(one, flush=True)
            print(f"    python benchmarks/filter.py --show {number} --seed {options.seed}")
    print(HEAD + "\n" + "|---" * (HEAD.count("|") - 1) + "|")
    for moving in (False, True):
        for kind in KINDS:
            named = f"{kind}, {'moving' if moving else 'still'}"
            print(row(named, (o for o in flown if (o.kind, o.moving) == (kind, moving))))
    print(row("all", flown))
    print(dict(Counter(one.fault for one in flown if one.fault)))
    return 0 if all(one.held for one in flown) else 1


HOLD = testbed.load("hold")
VEHICLE = HOLD.vehicles["sat1"].model

if __name__ == "__main__":
    sys.exit(main())
