"""Figures of a run: curves over an axis, like the paper's figures."""

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

Array = NDArray[np.float64]

POINTS = 2000  # points of a curve


class Figure(Struct, frozen=True):
    """One figure; curves by name: x and y."""

    name: str
    x: str
    y: str
    curves: dict[str, tuple[Array, Array]]
    dots: bool = False  # positions instead of curves over time: equal scales of both axes


def thinned(values: Array) -> Array:
    """Every n-th value, about POINTS in total."""
    return values[:: max(1, len(values) // POINTS)]
