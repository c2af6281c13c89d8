"""Where a vehicle is commissioned: a free and level place, and marks beside it."""

import math
from collections.abc import Callable
from itertools import product

import numpy as np

from testbed.commission.cameras import Mark
from testbed.commission.motion import Array
from testbed.config import Experiment

AROUND = (-1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0)  # offsets of a place [m]
LEVEL = 0.004  # slope that is level enough [m/s^2]
CARRIED = (0.4, 0.25)  # distances to a mark that are tried [m]


def marks_of(
    experiment: Experiment, name: str, slope: Callable[[float, float], Array]
) -> list[Mark]:
    """A place, and others beside it that are free; empty: there is no room.

    The place is the vehicle's start, or the most level one around it if the table is steep there.
    """
    setup, size = experiment.vehicles[name], experiment.table.size
    radius = setup.model.radius
    room = [0.5 * side - radius - experiment.flight.gate.fence_margin for side in size]

    def free(px: float, py: float) -> bool:
        if abs(px) > room[0] or abs(py) > room[1]:
            return False
        apart = [
            math.dist((px, py), one.start[:2]) - radius - one.model.radius
            for other, one in experiment.vehicles.items() if other != name
        ]  # fmt: skip
        apart += [
            math.dist((px, py), o.position) - radius - o.solid
            for o in experiment.obstacles.values()
        ]
        return min(apart, default=1.0) > 0.05

    def around(x: float, y: float) -> list[Mark]:
        for way in CARRIED:
            along = next((s * way for s in (1.0, -1.0) if free(x + s * way, y)), None)
            across = next((s * way for s in (1.0, -1.0) if free(x, y + s * way)), None)
            if along is not None and across is not None:
                return [
                    (x, y, 0.0), (x + along, y, 0.0), (x, y + across, 0.0), (x, y, 0.5 * math.pi),
                ]  # fmt: skip
        return []

    x, y, _ = setup.start
    offsets = sorted(product(AROUND, AROUND), key=lambda d: math.hypot(*d))
    places = [at for dx, dy in offsets if free(*(at := (x + dx, y + dy))) and around(*at)]
    steep = [float(np.hypot(*slope(*at))) for at in places]
    level = next((k for k, s in enumerate(steep) if s < LEVEL), None)
    if not places:
        return []
    return around(*places[int(np.argmin(steep)) if level is None else level])
