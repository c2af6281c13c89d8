"""What a vehicle may have touched, for the text of a fault.

A contact pushes a vehicle as a leaking valve does. The estimate tells whether a body or an edge was
near enough.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

from testbed.core.codes import Hazard
from testbed.core.table import Obstacle
from testbed.core.types import State

NEAR = 0.05  # largest gap of a possible contact: errors, and the way back until it shows [m]
RECENT = 3.0  # a contact explains a push for this long [s]

EDGES = tuple(one.words for one in Hazard if Hazard.RIGHT_EDGE <= one <= Hazard.LOWER_EDGE)


def place(state: State, t: float) -> tuple[float, float]:
    """Position of a vehicle at `t` at constant velocity."""
    h = t - state.t
    return state.pose.x + h * state.twist.vx, state.pose.y + h * state.twist.vy


class Contact(NamedTuple):
    """The nearest body or edge of a suspected contact, and when."""

    other: str  # body or edge
    t: float  # when its gap was smallest [s]
    gap: float = math.inf  # [m]


class Nearby:
    """The bodies and edges around one vehicle, and the nearest of them during a suspicion."""

    def __init__(
        self,
        radius: float,
        size: tuple[float, float],
        obstacles: Mapping[str, Obstacle],
        reaches: Mapping[str, float],
    ) -> None:
        """Look around a vehicle.

        Args:
            radius: of the vehicle [m].
            size: of the table [m].
            obstacles: on it.
            reaches: per other vehicle, the distance of the centres at contact [m].
        """
        self._half = size[0] / 2 - radius, size[1] / 2 - radius
        self._solid = {
            name: (one, radius + one.solid) for name, one in obstacles.items() if one.solid
        }
        self._reaches = reaches
        self._newest = Contact("", -math.inf)

    def look(self, t: float, state: State, neighbours: Mapping[str, State]) -> None:
        """Remember what is nearest at `t`, if it is near."""
        x, y = place(state, t)
        for edge, gap in zip(
            EDGES,
            (self._half[0] - x, self._half[0] + x, self._half[1] - y, self._half[1] + y),
            strict=True,
        ):
            self._note(edge, t, gap)
        for name, (one, reach) in self._solid.items():
            (ox, oy), (vx, vy) = one.position, one.velocity
            self._note(name, t, math.hypot(x - ox - t * vx, y - oy - t * vy) - reach)
        for name, other in neighbours.items():
            ox, oy = place(other, t)
            self._note(name, t, math.hypot(x - ox, y - oy) - self._reaches[name])

    def _note(self, name: str, t: float, gap: float) -> None:
        if gap < NEAR and (gap < self._newest.gap or t - self._newest.t > RECENT):
            self._newest = Contact(name, t, gap)

    def contact(self, t: float) -> str:
        """The possible contact before `t` as text; empty: none."""
        other, at, gap = self._newest
        if t - at > RECENT:
            return ""
        return f"contact with {other} ({100.0 * max(0.0, gap):.1f} cm away)"
