"""Runs put together: by two parameters for a map, and the best ones for a front."""

from collections.abc import Sequence

import numpy as np

from testbed.campaign import chart
from testbed.campaign.chart import Cell, Point
from testbed.campaign.result import Table
from testbed.campaign.summary import Quantity

FEW = 12  # values of a parameter that get a field each
BINS = 6


def best_front(points: Sequence[Point]) -> list[Point]:
    """Of the points that passed, those that no other beats in both numbers, from left to right."""
    front: list[Point] = []
    for point in sorted((p for p in points if p.passed), key=lambda p: (p.x, p.y)):
        if not front or point.y < front[-1].y:
            front.append(point)
    return front


def fields(values: Sequence[float]) -> tuple[list[int], list[str]]:
    """Which field of an axis each value belongs to, and what the fields are called."""
    distinct = sorted(set(values))
    if len(distinct) <= FEW:
        return [distinct.index(value) for value in values], [
            chart.number(float(f"{v:.3g}")) for v in distinct
        ]
    even = np.geomspace if chart.wants_log(distinct) else np.linspace
    edges = even(distinct[0], distinct[-1], BINS + 1)
    where = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, BINS - 1)
    return where.tolist(), [f"{v:.3g}" for v in 0.5 * (edges[1:] + edges[:-1])]


def heat_map(table: Table, a: str, b: str, what: Quantity | None) -> str:
    """Share that passed, or a number's median, over two parameters; empty if nothing is known."""
    columns, column_names = fields(table[a])
    rows, row_names = fields(table[b])
    met = [outcome == "passed" for outcome in table["outcome"]]
    numbers = [100.0 * m for m in met] if what is None else table[what.column]
    scale = 1.0 if what is None else what.scale
    groups: dict[tuple[int, int], list[float]] = {}
    for column, row, value in zip(columns, rows, numbers, strict=True):
        if value is not None:
            groups.setdefault((column, row), []).append(scale * float(value))
    if not groups:
        return ""
    pick = np.mean if what is None else np.median
    found = {spot: float(pick(values)) for spot, values in groups.items()}
    low, high = (0.0, 100.0) if what is None else (min(found.values()), max(found.values()))
    cells = [
        Cell(
            column, row, (value - low) / (high - low) if high > low else 0.5,
            f"{value:.3g}",
            f"{a} {column_names[column]}, {b} {row_names[row]}: {value:.4g} "
            f"({len(groups[column, row])} runs)",
        )
        for (column, row), value in found.items()
    ]  # fmt: skip
    return chart.heat(cells, column_names, row_names, a, b)
