"""What a run draws: curves over an axis, as a paper's figure has them."""

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

Array = NDArray[np.float64]

POINTS = 2000  # of a curve are enough


class Figure(Struct, frozen=True):
    """One picture; curves by name: x and y."""

    name: str
    x: str
    y: str
    curves: dict[str, tuple[Array, Array]]
    dots: bool = False  # places, not curves over time: same scale on both axes


def thinned(values: Array) -> Array:
    """At most about POINTS of them."""
    return values[:: max(1, len(values) // POINTS)]
