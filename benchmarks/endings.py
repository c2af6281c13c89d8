"""However a flight ends, its vehicles must stand: no contact in the minute after, air off.

    python benchmarks/endings.py N [--seed S]

Flies N flights on the twin, vehicles started anywhere on the table: ended as planned, by a stop at
a random instant, by a stop that is repeated within a second, and by the faults of the drill, all in
turn. Counts contacts harder than 2 cm/s in the minute after the end.

Said apart: flights with a vehicle whose process is dead. Its board keeps the bearing air on
(docs/firmware.md), and no process can brake it.
"""

import argparse
import sys

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from testbed.faults.drill import NAMES, draw
from testbed.metrics.afterwards import After
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin
from testbed.run.drill import EXPERIMENTS, NEEDED, SOON, somewhere

WHEN = (2.0, 30.0)  # [s] of an end as planned, and of a stop
AGAIN = 1.0  # [s] the second stop comes within
DEAD = "kill_process"
ENDS = ("planned", "stop", "stop twice")


class Flown(Struct, frozen=True):
    """How one flight ended, and the minute after."""

    end: str  # how it ended: one of ENDS, or a kind of injection
    after: After
    named: str


def fly(number: int, seed: int) -> Flown:
    """Flight `number`: ends and experiments take turns, the rest is drawn."""
    rng = np.random.default_rng([seed, number])
    # of four flights one ends by a fault
    group, turn = divmod(number, len(ENDS) + 1)
    kinds = list(NAMES)
    end = ENDS[turn] if turn < len(ENDS) else kinds[group % len(kinds)]
    experiment = somewhere(EXPERIMENTS[number // 2 % len(EXPERIMENTS)], rng)
    at = float(rng.uniform(*WHEN))
    experiment = replace(experiment, seed=int(rng.integers(2**31)))
    if end not in ENDS:
        jets = min(len(setup.model.jets) for setup in experiment.vehicles.values())
        what = draw(end, list(experiment.vehicles), jets, rng)
        duration = (what.at_s or 0.0) + NEEDED.get(end, SOON)
        experiment = replace(experiment, duration_s=duration, inject=[what])
    elif end == "planned":
        experiment = replace(experiment, duration_s=round(at, 1))
    first = at if end in ("stop", "stop twice") else np.inf
    second = first + float(rng.uniform(0.0, AGAIN)) if end == "stop twice" else np.inf
    rig = make_twin(experiment)

    def stopped() -> int:
        return int(rig.now >= first) + int(rig.now >= second)

    ending = rig.fly(NullObserver(), stopped)
    after = rig.come_to_rest(ending, NullObserver(), stopped)
    assert after is not None, rig.red
    return Flown(end, after, ending.fault.words if ending.fault else "")


def seconds(value: float | None) -> str:
    """A time, or a dash."""
    return "-" if value is None else f"{value:.2f}"


def row(name: str, flown: list[Flown]) -> str:
    """A row of the table."""
    rests = [one.after.at_rest_s for one in flown]
    known = [rest for rest in rests if rest is not None]
    median = float(np.median(known)) if known else None
    worst = max(known) if known and len(known) == len(rests) else None
    contacts = sum(one.after.contacts or 0 for one in flown)
    off = sum(one.after.air == "off" for one in flown)
    cells = (len(flown), contacts, len(known), off, seconds(median), seconds(worst))
    return f"{name:24}" + "".join(f"{cell!s:>10}" for cell in cells)


def main() -> int:
    """Fly, print, and judge."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("count", type=int)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    flown = [fly(number, options.seed) for number in range(options.count)]
    alive = [one for one in flown if one.end != DEAD]
    dead = [one for one in flown if one.end == DEAD]
    headings = ("flights", "contacts", "at rest", "air off", "median s", "worst s")
    print(f"{'end':24}" + "".join(f"{heading:>10}" for heading in headings))
    for name in dict.fromkeys(one.end for one in alive):
        print(row(name, [one for one in alive if one.end == name]))
    print(row("all of these", alive))
    if dead:
        print(row("process of one killed", dead))
    good = all(
        (one.after.contacts, one.after.air) == (0, "off") and one.after.at_rest_s is not None
        for one in alive
    )
    for one in alive:
        if (one.after.contacts, one.after.air) != (0, "off") or one.after.at_rest_s is None:
            print(f"  {one}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
