"""Figures of a run: curves over an axis, like the paper's figures."""

from fnmatch import fnmatchcase
from typing import Literal

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

Array = NDArray[np.float64]

POINTS = 2000  # points of a curve


class Reading(Struct, frozen=True):
    """Measures that can be read from a figure, and on which of its axes."""

    measures: tuple[str, ...]  # names, with * for any part
    axis: Literal["x", "y", ""] = "y"  # "": seen in the figure, but no value of an axis


class Figure(Struct, frozen=True):
    """One figure; curves by name: x and y."""

    name: str
    x: str
    y: str
    curves: dict[str, tuple[Array, Array]]
    dots: bool = False  # positions instead of curves over time: equal scales of both axes
    log: bool = False  # y
    circles: tuple[tuple[float, float, float], ...] = ()  # obstacles: x, y, danger radius
    ways: tuple[tuple[Array, Array], ...] = ()  # paths of moving obstacles
    shapes: tuple[tuple[Array, Array], ...] = ()  # curves to form
    readings: tuple[Reading, ...] = ()

    def axis_of(self, measure: str) -> str | None:
        """The axis on which the measure is read; None: the figure does not show it."""
        for reading in self.readings:
            if any(fnmatchcase(measure, one) for one in reading.measures):
                return reading.axis
        return None


def thinned(values: Array) -> Array:
    """Every n-th value, about POINTS in total."""
    return values[:: max(1, len(values) // POINTS)]
