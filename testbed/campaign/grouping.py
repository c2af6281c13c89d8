"""Points of a scatter with their Pareto front, and fields of a heat map, from the runs."""

from collections.abc import Sequence

import numpy as np

from testbed.campaign.result import Table
from testbed.campaign.summary import Groups
from testbed.report.axis import number, wants_log
from testbed.report.item import Mark

MOST_POINTS = 1500  # points of a scatter plot; more make the page large but not clearer
FEW = 12  # distinct values up to which each gets its own field
BINS = 6


def points_of(
    table: Table, x: str, y: str, scales: tuple[float, float], apart: Groups
) -> list[Mark]:
    """One mark per drawn run that has both numbers."""
    if x not in table or y not in table:  # no run lasted long enough to have numbers
        return []
    case = {run.k: place for place, group in enumerate(apart.shown) for run in group.runs}
    return [
        Mark(
            float(a) * scales[0], float(b) * scales[1],
            f"run {run}: {number(a * scales[0])}, {number(b * scales[1])}, {outcome}",
            outcome == "passed", case.get(run),
        )
        for run, a, b, outcome in zip(
            table["run"], table[x], table[y], table["outcome"], strict=True
        )
        if a is not None and b is not None and (run in case or not case)
    ]  # fmt: skip


def thinned(points: list[Mark]) -> list[Mark]:
    """At most MOST_POINTS points, evenly from all cases; failed runs have priority."""
    if len(points) <= MOST_POINTS:
        return points
    cases = {point.case for point in points}
    most, kept = MOST_POINTS // len(cases), []
    for case in cases:
        bad = [point for point in points if point.case == case and not point.passed][:most]
        good = [point for point in points if point.case == case and point.passed]
        stride = max(1, -(-len(good) // max(1, most - len(bad))))
        kept += good[::stride] + bad
    if len(cases) == 1:
        return kept
    drawn = set(kept)
    return [
        point for point in points if point in drawn
    ]  # the original order: no case covers another


def best_front(points: Sequence[Mark]) -> list[Mark]:
    """The Pareto front of the points that passed, from left to right."""
    front: list[Mark] = []
    for point in sorted((p for p in points if p.passed), key=lambda p: (p.x, p.y)):
        if not front or point.y < front[-1].y:
            front.append(point)
    return front


def fields(values: Sequence[float]) -> tuple[list[int], list[str]]:
    """The field index of each value along an axis, and the labels of the fields."""
    distinct = sorted(set(values))
    if len(distinct) <= FEW:
        return [distinct.index(value) for value in values], [
            number(float(f"{v:.3g}")) for v in distinct
        ]
    even = np.geomspace if wants_log(distinct) else np.linspace
    edges = even(distinct[0], distinct[-1], BINS + 1)
    where = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, BINS - 1)
    return where.tolist(), [f"{v:.3g}" for v in 0.5 * (edges[1:] + edges[:-1])]
