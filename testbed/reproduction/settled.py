"""Settling times of sampled conditions."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def settled_after(t: Array, off: NDArray[Any]) -> float | None:
    """First time after which no sample is `off`; None if the last one is."""
    late = np.flatnonzero(off)
    if len(late) == 0:
        return float(t[0])
    return float(t[late[-1] + 1]) if late[-1] + 1 < len(t) else None


def reached(t: Array, off: NDArray[Any]) -> float | None:
    """First time at which a sample is not `off`; None if there is none."""
    there = np.flatnonzero(~off)
    return float(t[there[0]]) if len(there) else None
