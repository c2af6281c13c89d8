"""The laws of benchmarks/filter.py: each wants a contact, at full thrust.

threat   full thrust towards the nearest obstacle, vehicle or edge
bang     full thrust along a line, which turns round at random
chase    at the next vehicle, ahead of it
gap      between the two nearest threats
random   a new direction at random
"""

import math
from collections.abc import Iterator
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from testbed.core.law import Body, Neighbours, World

Array = NDArray[np.float64]

Kind = Literal["threat", "bang", "chase", "gap", "random"]

CHANGES = 0.5  # mean number of changes of mind of `bang` and `random` [1/s]
AHEAD = 2.0  # `chase` aims at where the other is then [s]


class Adversary:
    """A law that wants a contact; it is called once per jet period."""

    step_s = 1.0  # longer than a period: one call in each

    def __init__(self, kind: Kind, seed: int, half: tuple[float, float]) -> None:
        """Make it; `half` is the distance of the edges from the table's middle [m]."""
        self._kind, self._seed, self._half = kind, seed, half
        self._rng: np.random.Generator | None = None  # of this vehicle
        self._way, self._until = np.zeros(2), -math.inf

    def force(self, own: Body, neighbours: Neighbours, world: World, t: float) -> Array:
        """Full thrust, shape (2,) [N]."""
        if self._rng is None:
            self._rng = np.random.default_rng([self._seed, own.vehicle_index])
        way = self._way_of(own, neighbours, world, t, self._rng)
        size = math.hypot(way[0], way[1])
        return way * (own.max_force / size) if size > 0.0 else np.zeros(2)

    def _way_of(
        self, own: Body, neighbours: Neighbours, world: World, t: float, rng: np.random.Generator
    ) -> Array:
        """Direction of the thrust."""
        if self._kind in ("bang", "random"):
            if t >= self._until:
                self._until = t + rng.exponential(1.0 / CHANGES)
                angle = rng.uniform(-math.pi, math.pi)
                turned = self._kind == "bang" and self._way.any()
                self._way = -self._way if turned else np.array([math.cos(angle), math.sin(angle)])
            return self._way
        if self._kind == "chase" and len(neighbours.p):
            ahead = neighbours.p + AHEAD * neighbours.v - own.p
            return ahead[np.argmin((ahead**2).sum(axis=1))]
        threats = sorted(self._threats(own, neighbours, world), key=lambda way: way @ way)
        return 0.5 * (threats[0] + threats[1]) if self._kind == "gap" else threats[0]

    def _threats(self, own: Body, neighbours: Neighbours, world: World) -> Iterator[Array]:
        """Vector from the vehicle to the nearest point of each threat [m]."""
        for discs in (world.obstacles, neighbours):
            for place, radius in zip(discs.p, discs.radius, strict=True):
                way = place - own.p
                far = max(math.hypot(way[0], way[1]), 1e-6)
                yield way * max(far - radius, 1e-3) / far
        for axis in (0, 1):
            for side in (-1.0, 1.0):
                way = np.zeros(2)
                way[axis] = side * self._half[axis] - own.p[axis]
                yield way
