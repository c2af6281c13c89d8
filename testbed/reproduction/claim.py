"""A paper, what it claims, and what is to be done to see whether that holds.

`configs/papers/<key>.toml` has all of it: how the print has to be read (`corrections`), what it
does not say (`assumptions`), the simulations (`runs`) and one entry per claim. What is measured is
compared here with what is claimed; no verdict stands in a file. `expected` is the outcome of the
day the entry was written, so that a change of it is noticed.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Annotated, Literal, cast

from msgspec import Meta, Struct

from testbed.core.error import TestbedError
from testbed.core.vehicle import NonNegative
from testbed.reproduction.run import Run

HOLDS, CORRECTED, FAILS = "holds", "holds with a correction", "fails"
UNTESTABLE = "cannot be tested"
Outcome = Literal["holds", "holds with a correction", "fails", "cannot be tested"]

CLAIM: Literal["claim"] = "claim"
CHECK: Literal["input check"] = "input check"
Kind = Literal["claim", "input check"]

Name = Annotated[str, Meta(pattern=r"^[a-z0-9_.]+$")]
Values = Mapping[str, Sequence[float | None]]  # by measure: one value per seed, null: there is none


class Correction(Struct, frozen=True, forbid_unknown_fields=True):
    """How something printed has to be read."""

    at: str  # equation, table
    printed: str
    read: str
    why: str


class Assumption(Struct, frozen=True, forbid_unknown_fields=True):
    """Something that a paper does not say."""

    what: str
    why: str


class Claim(Struct, frozen=True, forbid_unknown_fields=True):
    """One sentence of a paper that can be held against a number.

    An "input check" is one about this software instead: it refuses, or names a concern, where an
    assumption of the paper is broken. It is counted apart.
    """

    id: Name  # without the paper's key
    source: str  # figure, table, theorem, page
    claim: str
    paper: float | str  # what it says; words where it gives no number
    unit: str
    must: Literal["equal", "at most", "at least"] = "equal"
    limit: float | None = None  # what is compared with; null: `paper`
    tolerance: NonNegative = 0.0
    kind: Kind = CLAIM
    run: str | None = None
    measure: str | None = None
    over: str | None = None  # measured is the ratio to what this run measures
    corrections: tuple[str, ...] = ()  # besides the run's
    assumptions: tuple[str, ...] = ()
    note: str = ""
    untestable: str | None = None  # why it cannot be tested
    expected: Outcome = "holds"

    def __post_init__(self) -> None:
        if self.untestable is None and (self.run is None or self.measure is None):
            raise ValueError("expected a run and a measure, or a reason in `untestable`")
        if self.untestable is None and self.limit is None and isinstance(self.paper, str):
            raise ValueError("expected a `limit`, because `paper` is in words, found none")


class Paper(Struct, frozen=True, forbid_unknown_fields=True):
    """A file of configs/papers."""

    title: str
    source: str
    remark: str
    corrections: dict[str, Correction]
    assumptions: dict[str, Assumption]
    runs: dict[str, Run]
    claims: tuple[Claim, ...]

    def __post_init__(self) -> None:
        for problem in self._problems():
            raise ValueError(problem)

    def _problems(self) -> Iterator[str]:
        seen: set[str] = set()
        for claim in self.claims:
            if claim.id in seen:
                yield f"expected every claim once, found {claim.id} twice"
            seen.add(claim.id)
            for name in needed(claim):
                if name not in self.runs:
                    yield f"expected a run of {', '.join(self.runs)}, found {name} in {claim.id}"
        users: list[tuple[str, Claim | Run]] = [(claim.id, claim) for claim in self.claims]
        for where, user in [*users, *self.runs.items()]:
            for name in user.corrections:
                if name not in self.corrections:
                    yield f"expected a known correction in {where}, found {name}"
            for name in user.assumptions:
                if name not in self.assumptions:
                    yield f"expected a known assumption in {where}, found {name}"


def needed(claim: Claim) -> list[str]:
    """The runs that a claim wants."""
    return [] if claim.untestable else [name for name in (claim.run, claim.over) if name]


class Row(Struct, frozen=True):
    """A claim and what came out; the first eight are what a reader needs."""

    id: str
    source: str
    claim: str
    paper: float | str
    measured: float | None
    unit: str
    verdict: str
    assumption: str  # what had to be read differently or assumed; empty: nothing
    outcome: Outcome
    expected: Outcome
    must: str  # how measured and limit are compared
    limit: float | None
    tolerance: float
    seeds: int  # the worst of so many runs is measured
    quick: bool  # measured with fewer seeds and coarser steps
    note: str
    kind: Kind

    @property
    def as_expected(self) -> bool:
        """Whether the outcome is that of the file."""
        return self.outcome == self.expected


class MeasureError(TestbedError):
    """A claim asks for something that its run does not measure."""


def worst(claim: Claim, values: Sequence[float | None]) -> float | None:
    """The value that speaks most against the claim; null if there is one that does not exist."""
    known = [float(v) for v in values if v is not None and not math.isnan(v)]  # numpy's, too
    if len(known) < len(values) or not known:
        return None
    limit = limit_of(claim)
    if claim.must == "at most":
        return max(known)
    if claim.must == "at least":
        return min(known)
    return max(known, key=lambda value: abs(value - limit))


def limit_of(claim: Claim) -> float:
    """What the measured value is compared with."""
    return claim.limit if claim.limit is not None else float(claim.paper)


def met(claim: Claim, value: float | None) -> bool:
    """Whether a measured value is what the claim says."""
    if value is None:
        return False
    off = value - limit_of(claim)
    sign = {"at most": off, "at least": -off, "equal": abs(off)}[claim.must]
    return sign <= claim.tolerance


def values_of(key: str, claim: Claim, made: Mapping[str, Values]) -> list[float | None]:
    """One value per seed.

    Raises:
        MeasureError: a run does not measure that.
    """
    found = []
    for run in needed(claim):
        if claim.measure not in made[run]:
            known = ", ".join(sorted(made[run]))
            raise MeasureError(
                f"{key}.{claim.id}: expected a measure of run {run}: {known}; found {claim.measure}"
            )
        found.append(made[run][str(claim.measure)])
    if claim.over is None:
        return list(found[0])
    return [None if a is None or not b else a / b for a, b in zip(*found, strict=False)]


def judge(key: str, paper: Paper, claim: Claim, made: Mapping[str, Values], *, quick: bool) -> Row:
    """One row of the audit.

    Args:
        key: of the paper.
        paper: it.
        claim: one of its.
        made: what the runs measured, those of the claim at least.
        quick: how the run was made.

    Raises:
        MeasureError: a run does not measure that.
    """
    runs = [paper.runs[name] for name in needed(claim)]
    readings = [*(name for run in runs for name in run.corrections), *claim.corrections]
    guesses = [*(name for run in runs for name in run.assumptions), *claim.assumptions]
    if claim.kind == CHECK:  # of this software, which reads nothing differently
        readings, guesses = [], []
    notes = [f"{paper.corrections[n].at} read as {paper.corrections[n].read}" for n in readings]
    notes += [paper.assumptions[n].what for n in guesses]
    assumption = "; ".join(dict.fromkeys(notes))
    measured: float | None = None
    outcome, seeds = cast(Outcome, UNTESTABLE), 0
    if claim.untestable is None:
        found = values_of(key, claim, made)
        measured, seeds = worst(claim, found), len(found)
        kind = FAILS if not met(claim, measured) else CORRECTED if assumption else HOLDS
        outcome = cast(Outcome, kind)
    return Row(
        f"{key}.{claim.id}", claim.source, claim.claim, claim.paper, measured, claim.unit,
        verdict(claim, outcome, measured, assumption), assumption, outcome, claim.expected,
        claim.must, claim.limit if isinstance(claim.paper, str) else limit_of(claim),
        claim.tolerance, seeds, quick, claim.note, claim.kind,
    )  # fmt: skip


def verdict(claim: Claim, outcome: str, measured: float | None, assumption: str) -> str:
    """The outcome as a sentence that can be quoted."""
    if claim.kind == CHECK:
        return "input check passed" if outcome == HOLDS else "input check failed"
    if outcome == HOLDS:
        return "reproduced"
    if outcome == CORRECTED:
        return f"reproduced with assumption: {assumption}"
    if outcome == UNTESTABLE:
        return f"not reproducible: {claim.untestable}"
    found = "it never happens" if measured is None else f"measured {measured:.4g} {claim.unit}"
    wanted = f"{claim.must} {limit_of(claim):g} {claim.unit}".replace("equal ", "")
    return f"not reproducible: {found.rstrip()}, claimed {wanted.rstrip()}"


def claimed(row: Row) -> str:
    """What the paper says, with its unit; for words, with the limit that stands for them."""
    sign = {"at most": "<= ", "at least": ">= ", "equal": ""}[row.must]
    slack = f" (+- {row.tolerance:g})" if row.tolerance and row.must == "equal" else ""
    if isinstance(row.paper, float | int):
        return f"{sign}{row.paper:.6g} {row.unit}".strip() + slack
    if row.outcome == UNTESTABLE or row.limit is None or _names(row.paper, row.limit):
        return row.paper
    return f"{row.paper} ({sign}{row.limit:.6g} {row.unit}".rstrip() + f"{slack})"


def _names(words: str, limit: float) -> bool:
    """Whether words such as "> 1" are the limit itself."""
    sign, _, number = words.partition(" ")
    try:
        return sign in ("<", ">", "<=", ">=") and float(number) == limit
    except ValueError:
        return False


class Counts(Struct, frozen=True):
    """How many of each outcome; input checks are not claims."""

    claims: dict[str, int]
    input_checks: dict[str, int]

    def __str__(self) -> str:
        """In one line."""
        said = ", ".join(f"{n} {kind}" for kind, n in self.claims.items())
        total, checks = sum(self.claims.values()), sum(self.input_checks.values())
        failed = checks - self.input_checks["passed"]
        beside = f"{failed} of them failed" if failed else "all passed"
        apart = f"; {checks} input checks, {beside}" if checks else ""
        return f"{total} claims: {said}{apart}"


def counts(rows: Iterable[Row]) -> Counts:
    """The rows counted."""
    claims = dict.fromkeys((HOLDS, CORRECTED, FAILS, UNTESTABLE), 0)
    checks = {"passed": 0, "failed": 0}
    for row in rows:
        if row.kind == CHECK:
            checks["passed" if row.outcome == HOLDS else "failed"] += 1
        else:
            claims[row.outcome] += 1
    return Counts(claims, checks)
