"""Wrong laws and parameters, and what they measure: `plants.toml`, read and flown.

`PYTHONPATH=. python tests/reproduction/plant.py` flies them all and prints every value that is not
the recorded one.
"""

import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct

from testbed.config.key import Key, assignment
from testbed.config.tree import read_toml
from testbed.reproduction.claim import Claim, ClaimRow, Paper, Values, judge, needed, worst
from testbed.reproduction.paper import PAPERS, complete_runs, keys, read_papers
from testbed.reproduction.run import Run, execute

NEVER = "never"  # TOML has no null


class Plant(Struct, frozen=True, forbid_unknown_fields=True):
    """A run that is made wrongly, or a value that something wrong would measure."""

    paper: str
    run: str
    wrong: str  # in words
    fails: dict[str, float | str]  # claim, and the worst that is measured then, with --quick
    set: tuple[str, ...] = ()  # key=value, on top of the run's
    flown: bool = False  # by the tests; the others are only judged


class Plants(Struct, frozen=True, forbid_unknown_fields=True):
    """The file."""

    reasons: dict[str, str]  # claims that hold and have no plant
    plants: list[Plant]


def read_plants() -> Plants:
    """The shipped ones."""
    text = Path(__file__).with_name("plants.toml").read_bytes()
    return msgspec.toml.decode(text, type=Plants)


def planted(paper: Paper, plant: Plant, claim: Claim) -> ClaimRow:
    """The row of a claim if what is recorded were measured."""
    found = plant.fails[claim.id]
    value = None if found == NEVER else float(found)
    made: dict[str, Values] = {name: {str(claim.measure): [1.0]} for name in needed(claim)}
    made[str(claim.run)] = {str(claim.measure): [value]}
    return judge(plant.paper, paper, claim, made, quick=True)


def wrong_run(plant: Plant) -> Run:
    """The run with the plant's values on top."""
    runs = read_toml(PAPERS / f"{plant.paper}.toml")["runs"]
    complete_runs(runs)
    tree = runs[plant.run]
    for text in plant.set:
        key, raw = assignment(text)
        put(tree, key, tomllib.loads(f"value = {raw}")["value"])
    return msgspec.convert(tree, Run)


def put(tree: Any, key: Key, value: Any) -> None:
    """Set one entry; `*` is every entry of a list, `1` the first."""
    first, *rest = key
    if isinstance(tree, list) and first != "*":
        first = int(first) - 1  # entries count from 1
    for name in range(len(tree)) if first == "*" else [first]:
        if not rest:
            tree[name] = value
        else:
            if isinstance(tree, dict):
                tree.setdefault(name, {})
            put(tree[name], tuple(rest), value)


def flown(paper: Paper, plant: Plant) -> Iterator[tuple[Claim, float | None]]:
    """Fly it: each claim of its run that is no ratio, and the worst that was measured."""
    values, _ = execute(wrong_run(plant), quick=True)
    for claim in paper.claims:
        if claim.run == plant.run and claim.untestable is None and claim.over is None:
            yield claim, worst(claim, values[str(claim.measure)])


def main() -> int:
    """Fly all; 1 if a record is stale."""
    papers, stale = read_papers(keys()), 0
    for plant in read_plants().plants:
        if not plant.set:
            continue
        for claim, value in flown(papers[plant.paper], plant):
            if claim.id in plant.fails:
                record, now = plant.fails[claim.id], NEVER if value is None else f"{value:.4g}"
                if now != (record if record == NEVER else f"{record:.4g}"):
                    name = f"{plant.paper}.{claim.id}"
                    sys.stdout.write(f"{name}, {plant.wrong}: {now}, recorded {record}\n")
                    stale = 1
    return stale


if __name__ == "__main__":
    sys.exit(main())
