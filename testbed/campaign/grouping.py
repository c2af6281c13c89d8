"""Groups runs by two parameters for a heat map, and finds the Pareto front."""

from collections.abc import Sequence

import numpy as np

from testbed.campaign.axis import number, wants_log
from testbed.campaign.chart import Point

FEW = 12  # distinct values up to which each gets its own field
BINS = 6


def best_front(points: Sequence[Point]) -> list[Point]:
    """The Pareto front of the points that passed, from left to right."""
    front: list[Point] = []
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
