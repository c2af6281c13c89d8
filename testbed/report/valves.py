"""When a jet was open: as its board reports it, else as planned."""

import numpy as np
from numpy.typing import NDArray

from testbed.logs.history import VehicleHistory

Array = NDArray[np.float64]


def openings(vehicle: VehicleHistory, jet: int, delay: float) -> tuple[Array, Array]:
    """Times and durations of a jet's openings [s]; `delay` is from plan to valve [s]."""
    if len(vehicle.edges):
        return reported(vehicle.edges, jet)
    is_open = vehicle.on[:, jet] > 0.0
    return vehicle.t[is_open] + delay + vehicle.offset[is_open, jet], vehicle.on[is_open, jet]


def reported(edges: Array, jet: int) -> tuple[Array, Array]:
    """Times and durations of a jet's openings [s], from the board's edges (t, mask)."""
    is_open = (edges[:, 1].astype(int) >> jet) & 1
    before = np.concatenate([[0], is_open[:-1]])
    starts = edges[(is_open == 1) & (before == 0), 0]
    ends = edges[(is_open == 0) & (before == 1), 0]
    return starts[: len(ends)], ends - starts[: len(ends)]
