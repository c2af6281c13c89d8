"""Summary of a campaign: success rate, distributions of numbers, worst runs."""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import Struct

from testbed.campaign.flight import CampaignEnd
from testbed.campaign.interval import Rate, success_rate
from testbed.campaign.result import Table
from testbed.campaign.row import FlownRun
from testbed.campaign.sweep import Campaign

FAULTS = 100  # faults that a summary lists; results.parquet has all
MOST_GROUPS = 6  # distinguishable colours and marks


class Quantity(Struct, frozen=True):
    """A number that summaries and reports show."""

    column: str
    title: str
    unit: str
    scale: float = 1.0  # factor from the column to the unit
    largest_is_worst: bool = True

    @property
    def titled(self) -> str:
        """Title of the quantity with its unit, for axes."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title


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


ERRORS = ("shape_rms_m", "goal_rms_m", "track_rms_m", "final_error_m")


class Spread(Struct, frozen=True):
    """Distribution of a number over the runs, in its unit."""

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


class Group(Struct, frozen=True):
    """Runs with the same colour and mark."""

    name: str
    runs: list[FlownRun]


class Groups(Struct, frozen=True):
    """Groups of runs that the figures distinguish; empty if all runs are of one kind."""

    axes: list[str]  # of the grid
    shown: list[Group]
    left_out: int = 0  # number of groups that are not shown
    pooled: list[str] = []  # axes of the grid that vary within a group

    def name_of(self, case: Mapping[str, str]) -> str:
        """Name of the group of a combination of the grid."""
        return ", ".join(case[axis] for axis in self.axes)

    def place(self, name: str) -> int | None:
        """Index of a group's colour and mark; None if it is not shown."""
        return next((k for k, group in enumerate(self.shown) if group.name == name), None)

    @property
    def rest(self) -> str:
        """A sentence on groups that are not drawn, or an empty string."""
        count = len(self.shown)
        words = (
            f" The first {count} of {count + self.left_out} are drawn, {self.left_out} left out."
        )
        return words if self.left_out else ""

    def sentence(self, combinations: int) -> str:
        """A sentence on how the figures distinguish the cases."""
        if not self.shown:
            return "The figures below pool all cases."
        words = "Below, each case has a colour and a mark of its own."
        if self.pooled:
            words = (
                f"{combinations} cases are too many to distinguish: below, each "
                f"{' and '.join(self.axes)} has a colour and a mark of its own, whatever its "
                f"{' and '.join(self.pooled)} is."
            )
        return words + self.rest


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
    faults: list[str] = []  # of the first flights with a fault: run, seed, fault, time


def summarise(campaign: Campaign, experiment: str, ended: CampaignEnd) -> Summary:
    """Summarise the finished runs."""
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
        faults=[
            f"run {run.k}, {run.explained(run.reason)}" for run in failed if run.outcome == "fault"
        ][:FAULTS],
    )


def short_reason(run: FlownRun) -> str:
    """The reason without numbers, so that equal reasons can be counted."""
    if run.fault is not None:
        return f"{run.outcome}: {' '.join(filter(None, (run.fault.vehicle, run.fault.title)))}"
    text = run.reason.strip().splitlines()[-1] if run.reason.strip() else run.outcome
    words = ["..." if any(c.isdigit() for c in word) else word for word in text.split()]
    return f"{run.outcome}: {' '.join(words)}"[:120]


def cases(campaign: Campaign, runs: Sequence[FlownRun]) -> list[Case]:
    """Success rate of each combination of the grid; empty if there is only one."""
    axes = [axis.label for axis in campaign.file.grid]
    found = by_axes(campaign, runs, axes)
    if len(found) < 2:
        return []
    return [
        Case(
            dict(zip(axes, point, strict=True)),
            success_rate(
                sum(run.outcome == "passed" for run in met), len(met), campaign.file.confidence
            ),
        )
        for point, met in found.items()
    ]


def by_axes(
    campaign: Campaign, runs: Sequence[FlownRun], axes: Sequence[str]
) -> dict[tuple[str, ...], list[FlownRun]]:
    """The runs by their values on some axes, in the order of the grid."""
    points: dict[int, tuple[str, ...]] = {}
    found: dict[tuple[str, ...], list[FlownRun]] = {}
    for run in sorted(runs, key=lambda run: run.k % campaign.combinations):
        place = run.k % campaign.combinations
        if place not in points:
            parameters = campaign.parameters(place)
            points[place] = tuple(str(parameters[name]) for name in axes)
        found.setdefault(points[place], []).append(run)
    return found


def named_axes(campaign: Campaign) -> list[str]:
    """Axes of the grid with non-numeric values."""
    return [
        axis.label
        for axis in campaign.file.grid
        if any(isinstance(v, bool) or not isinstance(v, int | float) for v, _ in axis.points())
    ]


def numeric_parameters(campaign: Campaign, table: Table) -> list[str]:
    """Parameters that were set or drawn, are numeric and vary."""
    names = [axis.label for axis in campaign.file.grid] + [d.label for d in campaign.file.draw]
    return [
        name
        for name in names
        if all(isinstance(v, int | float) and not isinstance(v, bool) for v in table.get(name, ()))
        and len(set(table.get(name, ()))) > 1
    ]


def groups(campaign: Campaign, runs: Sequence[FlownRun]) -> Groups:
    """The runs by case, or by the non-numeric axes if there are too many cases."""
    axes = [axis.label for axis in campaign.file.grid]
    if len(by_axes(campaign, runs, axes)) > MOST_GROUPS:
        axes = named_axes(campaign)
    return groups_by(campaign, runs, axes)


def groups_by(campaign: Campaign, runs: Sequence[FlownRun], axes: list[str]) -> Groups:
    """The runs grouped by some axes of the grid."""
    found = by_axes(campaign, runs, axes)
    if len(found) < 2:
        return Groups(axes, [])
    every = [Group(", ".join(point), flown) for point, flown in found.items()]
    pooled = [axis.label for axis in campaign.file.grid if axis.label not in axes]
    return Groups(axes, every[:MOST_GROUPS], len(every[MOST_GROUPS:]), pooled)


def spread(quantity: Quantity, runs: Sequence[FlownRun]) -> Spread | None:
    """Distribution of a number over the runs that have it."""
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


def in_field(runs: Sequence[FlownRun], what: Quantity | None) -> tuple[float, int] | None:
    """The value of a field of a heat map, and its number of runs."""
    if what is None:
        return 100.0 * sum(run.outcome == "passed" for run in runs) / len(runs), len(runs)
    one = spread(what, runs)
    return (one.median, one.runs) if one else None


def main_error(summary: Summary, table: Table) -> Quantity:
    """The main error of the campaign: of the formation if there is one, else to the goal."""
    known = {one.quantity.column: one.quantity for one in summary.spreads}
    names = [name for name in ERRORS if name in known]
    law_has_formation = any(value is not None for value in table.get("shape_rms_m", ()))
    if law_has_formation:
        return known["shape_rms_m"]
    return known[names[0]] if names else Quantity("duration_s", "flown", "s")


def worst_runs(runs: Sequence[FlownRun], quantity: Quantity, count: int = 10) -> list[FlownRun]:
    """The worst runs: first by outcome, then by the number."""
    order = {"lost": 0, "error": 1, "refused": 2, "fault": 3, "failed": 4, "passed": 5}
    sign = -1.0 if quantity.largest_is_worst else 1.0

    def rank(run: FlownRun) -> tuple[int, float, int]:
        value = run.columns.get(quantity.column)
        return order[run.outcome], float("-inf") if value is None else sign * float(value), run.k

    return sorted(runs, key=rank)[:count]
