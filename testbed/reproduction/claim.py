"""A paper, its claims, and the checks of these claims.

`configs/papers/<key>.toml` contains the corrections of the print (`corrections`), what the paper
does not state (`assumptions`), the simulations (`runs`) and one entry per claim. This module
compares measured with claimed values; the files contain no verdicts. `expected` is the outcome when
the entry was written, so that changes are detected.
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
Values = Mapping[str, Sequence[float | None]]  # by measure: one value per seed, None: undefined


class Correction(Struct, frozen=True, forbid_unknown_fields=True):
    """A correction of the print."""

    at: str  # equation, table
    printed: str
    read: str
    why: str


class Assumption(Struct, frozen=True, forbid_unknown_fields=True):
    """An assumption about something that the paper does not state."""

    what: str
    why: str


class Claim(Struct, frozen=True, forbid_unknown_fields=True):
    """One statement of a paper that can be compared with a number.

    An "input check" is a statement about this software instead: it rejects input, or raises a
    concern, if an assumption of the paper is violated. It is counted separately.
    """

    id: Name  # without the paper's key
    source: str  # figure, table, theorem, page
    claim: str
    paper: float | str  # claimed value; text if the paper gives no number
    unit: str
    must: Literal["equal", "at most", "at least"] = "equal"
    limit: float | None = None  # value for the comparison; null: `paper`
    tolerance: NonNegative = 0.0
    kind: Kind = CLAIM
    run: str | None = None
    measure: str | None = None
    over: str | None = None  # compare the ratio to this run's value of the measure
    corrections: tuple[str, ...] = ()  # in addition to the run's
    assumptions: tuple[str, ...] = ()
    note: str = ""
    untestable: str | None = None  # why it cannot be tested
    expected: Outcome = "holds"

    def __post_init__(self) -> None:
        if self.untestable is None and (self.run is None or self.measure is None):
            raise ValueError("expected a run and a measure, or a reason in `untestable`")
        if self.untestable is None and self.limit is None and isinstance(self.paper, str):
            raise ValueError("expected a `limit`, because `paper` is text, found none")


class Points(Struct, frozen=True, forbid_unknown_fields=True):
    """Numbers that the paper prints, or a digitised curve, for a figure of a run's report."""

    source: str  # table, or figure and how it was digitised
    what: str
    experiment: str  # of configs/experiments
    figure: str  # key of a figure of its report, such as "trajectory" or "error"
    x: tuple[float, ...]  # in the figure's units
    y: tuple[float, ...]

    def __post_init__(self) -> None:
        if not len(self.x) == len(self.y) > 0:
            raise ValueError("expected as many x as y, at least one")


class Paper(Struct, frozen=True, forbid_unknown_fields=True):
    """A file of configs/papers."""

    title: str
    source: str
    remark: str
    corrections: dict[str, Correction]
    assumptions: dict[str, Assumption]
    runs: dict[str, Run]
    claims: tuple[Claim, ...]
    points: tuple[Points, ...] = ()

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
    """The runs that a claim needs."""
    return [] if claim.untestable else [name for name in (claim.run, claim.over) if name]


class ClaimRow(Struct, frozen=True):
    """A claim and its outcome; the first eight fields are for the reader."""

    id: str
    source: str
    claim: str
    paper: float | str
    measured: float | None
    unit: str
    verdict: str
    assumption: str  # corrections and assumptions used; empty: none
    outcome: Outcome
    expected: Outcome
    must: str  # comparison of measured value and limit
    limit: float | None
    tolerance: float
    seeds: int  # number of runs, the worst of which is measured
    quick: bool  # measured with fewer seeds and coarser steps
    note: str
    kind: Kind

    @property
    def as_expected(self) -> bool:
        """Whether the outcome is the one in the file."""
        return self.outcome == self.expected


class MeasureError(TestbedError):
    """A claim uses a measure that its run does not have."""


def worst(claim: Claim, values: Sequence[float | None]) -> float | None:
    """The value least favourable to the claim; None if a value is undefined."""
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
    """The value that the measured value is compared with."""
    return claim.limit if claim.limit is not None else float(claim.paper)


def met(claim: Claim, value: float | None) -> bool:
    """Whether a measured value satisfies the claim."""
    if value is None:
        return False
    off = value - limit_of(claim)
    sign = {"at most": off, "at least": -off, "equal": abs(off)}[claim.must]
    return sign <= claim.tolerance


def values_of(key: str, claim: Claim, made: Mapping[str, Values]) -> list[float | None]:
    """Measured values of a claim, one per seed.

    Raises:
        MeasureError: a run does not have the measure.
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


def judge(
    key: str, paper: Paper, claim: Claim, made: Mapping[str, Values], *, quick: bool
) -> ClaimRow:
    """One row of the audit.

    Args:
        key: of the paper.
        paper: the paper.
        claim: one of its claims.
        made: results of the runs, at least those of the claim.
        quick: whether the runs were quick.

    Raises:
        MeasureError: a run does not have the measure.
    """
    runs = [paper.runs[name] for name in needed(claim)]
    readings = [*(name for run in runs for name in run.corrections), *claim.corrections]
    guesses = [*(name for run in runs for name in run.assumptions), *claim.assumptions]
    if claim.kind == CHECK:  # about this software, so no corrections apply
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
    return ClaimRow(
        f"{key}.{claim.id}", claim.source, claim.claim, claim.paper, measured, claim.unit,
        verdict(claim, outcome, measured, assumption), assumption, outcome, claim.expected,
        claim.must, claim.limit if isinstance(claim.paper, str) else limit_of(claim),
        claim.tolerance, seeds, quick, claim.note, claim.kind,
    )  # fmt: skip


def verdict(claim: Claim, outcome: str, measured: float | None, assumption: str) -> str:
    """The outcome as a sentence."""
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


def claimed(row: ClaimRow) -> str:
    """The claimed value with its unit; a text with the limit used for it."""
    sign = {"at most": "<= ", "at least": ">= ", "equal": ""}[row.must]
    slack = f" (+- {row.tolerance:g})" if row.tolerance and row.must == "equal" else ""
    if isinstance(row.paper, float | int):
        return f"{sign}{row.paper:.6g} {row.unit}".strip() + slack
    if row.outcome == UNTESTABLE or row.limit is None or _names(row.paper, row.limit):
        return row.paper
    return f"{row.paper} ({sign}{row.limit:.6g} {row.unit}".rstrip() + f"{slack})"


def _names(words: str, limit: float) -> bool:
    """Whether a text such as "> 1" already states the limit."""
    sign, _, number = words.partition(" ")
    try:
        return sign in ("<", ">", "<=", ">=") and float(number) == limit
    except ValueError:
        return False


class VerdictCounts(Struct, frozen=True):
    """Number of claims by outcome; input checks are counted separately."""

    claims: dict[str, int]
    input_checks: dict[str, int]

    def __str__(self) -> str:
        """Claim, measured value and verdict in one line."""
        text = ", ".join(f"{n} {kind}" for kind, n in self.claims.items())
        total, checks = sum(self.claims.values()), sum(self.input_checks.values())
        failed = checks - self.input_checks["passed"]
        beside = f"{failed} of them failed" if failed else "all passed"
        apart = f"; {checks} input checks, {beside}" if checks else ""
        return f"{total} claims: {text}{apart}"


def counts(rows: Iterable[ClaimRow]) -> VerdictCounts:
    """Count the outcomes of rows."""
    claims = dict.fromkeys((HOLDS, CORRECTED, FAILS, UNTESTABLE), 0)
    checks = {"passed": 0, "failed": 0}
    for row in rows:
        if row.kind == CHECK:
            checks["passed" if row.outcome == HOLDS else "failed"] += 1
        else:
            claims[row.outcome] += 1
    return VerdictCounts(claims, checks)
