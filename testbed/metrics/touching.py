"""Distances at contacts: between two camera frames vehicles may be nearer than in any of them."""

import math
from collections.abc import Collection, Iterable, Mapping

from testbed.core.table import Obstacle
from testbed.metrics.run_metrics import Touch


def nearest_vehicles(
    sampled: float | None, touches: Iterable[Touch], radii: Mapping[str, float]
) -> float | None:
    """Smallest distance of two vehicles, centre to centre [m].

    Args:
        sampled: the smallest one at a frame; None: there is none [m].
        touches: contacts.
        radii: radius of each vehicle [m].
    """
    if sampled is None:
        return None
    met = (radii[one.vehicle] + radii[one.other] for one in touches if one.other in radii)
    return min(sampled, min(met, default=math.inf))


def smallest_gap(sampled: float, touches: Iterable[Touch], vehicles: Collection[str]) -> float:
    """Smallest gap between the surfaces of two vehicles [m].

    Args:
        sampled: the smallest one at a frame [m].
        touches: contacts.
        vehicles: their names.
    """
    return min(sampled, 0.0) if any(one.other in vehicles for one in touches) else sampled


def nearest_obstacles(
    sampled: Mapping[str, float], touches: Iterable[Touch], vehicle: str, radius: float,
    obstacles: Mapping[str, Obstacle],
) -> dict[str, float]:  # fmt: skip
    """Smallest distance of a vehicle to each obstacle, centre to centre [m].

    Args:
        sampled: the smallest ones at frames [m].
        touches: contacts of all vehicles.
        vehicle: name of the vehicle.
        radius: of the vehicle [m].
        obstacles: by name.
    """
    hit = {one.other for one in touches if one.vehicle == vehicle}
    return {
        name: min(distance, radius + obstacles[name].solid) if name in hit else distance
        for name, distance in sampled.items()
    }
