"""A law: a spring to the goal, and springs away from all that is near.

controller = { type = "python", law = "springs", parameters = { push = 0.2 } }
"""

from typing import Annotated

import numpy as np
from msgspec import Meta, Struct

from testbed.core.law import Array, Body, Neighbours, World

Positive = Annotated[float, Meta(gt=0.0)]


class Springs(Struct, frozen=True):
    """The law and its parameters."""

    stiffness: Positive = 0.02  # [1/s^2]
    damping: Positive = 0.28  # [1/s]
    push: Positive = 0.15  # [m/s^2]
    reach: Positive = 0.3  # [m]
    step_s: Positive = 0.02  # how often `force` is asked

    def force(self, own: Body, neighbours: Neighbours, world: World, t: float) -> Array:
        """The force (d,) [N]."""
        pull = world.goal.p - own.p
        pull = self.stiffness * pull / max(1.0, float(np.linalg.norm(pull)))
        a = pull - self.damping * own.v - own.disturbance
        for things in (world.obstacles, neighbours):
            for p, radius in zip(things.p, things.radius, strict=True):
                away = own.p - p
                gap = max(1e-9, float(np.linalg.norm(away)))
                depth = max(0.0, 1.0 - (gap - radius) / self.reach)
                a = a + self.push * depth**2 * away / gap
        return own.mass * a
