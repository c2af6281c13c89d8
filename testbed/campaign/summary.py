"""What a campaign says: how often it succeeds, where its numbers lie, which runs are worst."""

from collections import Counter
from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from testbed.campaign.flight import Ended
from testbed.campaign.interval import Rate, success_rate
from testbed.campaign.row import Flown
from testbed.campaign.sweep import Campaign


class Quantity(Struct, frozen=True):
    """A number worth showing."""

    column: str
    title: str
    unit: str
    scale: float = 1.0  # from the column to the unit
    largest_is_worst: bool = True


QUANTITIES = (
    Quantity("goal_rms_m", "RMS error to the goal", "mm", 1e3),
    Quantity("shape_rms_m", "RMS error of the formation", "mm", 1e3),
    Quantity("track_rms_m", "tracking RMS", "mm", 1e3),
    Quantity("heading_rms_deg", "heading RMS", "deg"),
    Quantity("settle_s", "settled after", "s"),
    Quantity("clearance_m", "clearance to obstacles", "m", 1.0, largest_is_worst=False),
    Quantity("min_vehicle_distance_m", "nearest two vehicles", "m", 1.0, largest_is_worst=False),
    Quantity("impulse_ns", "impulse", "N s"),
    Quantity("gas_g", "gas", "g"),
    Quantity("valve_pulses", "valve pulses", ""),
)


class Spread(Struct, frozen=True):
    """Where a number lies, in its unit."""

    quantity: Quantity
    runs: int
    best: float
    median: float
    p95: float  # 95 % of the runs are at least as good
    worst: float
    worst_run: int


class Case(Struct, frozen=True):
    """One combination of the grid."""

    name: dict[str, str]
    rate: Rate


class Summary(Struct, frozen=True):
    """Content of summary.json, and what `--json` prints."""

    campaign: str
    experiment: str
    runs: int
    planned: int
    succeeded: int
    success_rate: float | None
    confidence_interval: tuple[float, float]
    confidence: float
    outcomes: dict[str, int]
    reasons: dict[str, int]
    wall_s: float
    runs_per_second: float | None
    resumed: int
    worker_memory_mb: float
    not_repeatable: list[int]
    cases: list[Case]
    spreads: list[Spread]


def summarise(campaign: Campaign, experiment: str, ended: Ended) -> Summary:
    """The summary of the runs that are over."""
    runs, file = ended.runs, campaign.file
    passed = sum(run.outcome == "passed" for run in runs)
    rate = success_rate(passed, len(runs), file.confidence)
    flown = len(runs) - ended.resumed
    failed = [run for run in runs if run.outcome != "passed"]
    return Summary(
        campaign=file.name,
        experiment=experiment,
        runs=len(runs),
        planned=campaign.count,
        succeeded=passed,
        success_rate=rate.rate,
        confidence_interval=(rate.low, rate.high),
        confidence=file.confidence,
        outcomes=dict(sorted(Counter(str(run.outcome) for run in runs).items())),
        reasons=dict(Counter(short_reason(run) for run in failed).most_common(10)),
        wall_s=ended.wall_s,
        runs_per_second=flown / ended.wall_s if flown and ended.wall_s > 0.0 else None,
        resumed=ended.resumed,
        worker_memory_mb=max((run.memory_mb for run in runs), default=0.0),
        not_repeatable=ended.unlike,
        cases=cases(campaign, runs),
        spreads=[s for s in (spread(quantity, runs) for quantity in QUANTITIES) if s],
    )


def short_reason(run: Flown) -> str:
    """Why it did not pass, in the words that many runs share."""
    text = run.reason.strip().splitlines()[-1] if run.reason.strip() else run.outcome
    words = ["#" if any(c.isdigit() for c in word) else word for word in text.split()]
    return f"{run.outcome}: {' '.join(words)}"[:120]


def cases(campaign: Campaign, runs: Sequence[Flown]) -> list[Case]:
    """Success of each combination of the grid; none where there is but one."""
    axes = [axis.label for axis in campaign.file.grid]
    found: dict[tuple[str, ...], list[bool]] = {}
    for run in sorted(runs, key=lambda run: run.k % campaign.combinations):
        parameters = campaign.parameters(run.k)
        point = tuple(str(parameters[name]) for name in axes)
        found.setdefault(point, []).append(run.outcome == "passed")
    if len(found) < 2:
        return []
    return [
        Case(
            dict(zip(axes, point, strict=True)),
            success_rate(sum(met), len(met), campaign.file.confidence),
        )
        for point, met in found.items()
    ]


def spread(quantity: Quantity, runs: Sequence[Flown]) -> Spread | None:
    """Where a number lies among the runs that have it."""
    have = [(run.columns.get(quantity.column), run.k) for run in runs]
    known = [(float(value) * quantity.scale, k) for value, k in have if value is not None]
    if not known:
        return None
    known.sort(reverse=not quantity.largest_is_worst)
    values = np.array([value for value, _ in known])
    last = min(len(values) - 1, int(np.ceil(0.95 * len(values))) - 1)
    return Spread(
        quantity, len(known), float(values[0]), float(np.median(values)), float(values[last]),
        float(values[-1]), known[-1][1],
    )  # fmt: skip


def worst_runs(runs: Sequence[Flown], quantity: Quantity, count: int = 10) -> list[Flown]:
    """The runs to look at first: those that ended badly, then the worst numbers."""
    order = {"lost": 0, "error": 1, "refused": 2, "fault": 3, "failed": 4, "passed": 5}
    sign = -1.0 if quantity.largest_is_worst else 1.0

    def rank(run: Flown) -> tuple[int, float, int]:
        value = run.columns.get(quantity.column)
        return order[run.outcome], float("-inf") if value is None else sign * float(value), run.k

    return sorted(runs, key=rank)[:count]
