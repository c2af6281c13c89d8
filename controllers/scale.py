"""From a paper's units to the table's and back: one small adapter round any law.

zhang2023 reuses its space parameters on the table, where 50 m become 0.8 m. With a length scale L
and a time scale T

    position_paper = L position        velocity_paper = L/T velocity
    time_paper     = T time            acceleration   = T^2/L acceleration_paper

and the nominal mass of the paper's satellite stands for the vehicle's.
"""

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from testbed.core.law import Ahead, Body, Concern, Discs, Goal, Law, Neighbours, World
from testbed.core.vehicle import Positive

Array = NDArray[np.float64]


class Scale(Struct, frozen=True, forbid_unknown_fields=True):
    """How much larger, slower and heavier the paper's world is; 1, 1: the same."""

    length: Positive = 1.0  # L
    time: Positive = 1.0  # T
    mass: Positive | None = None  # of the paper's satellite; null: as heavy as the vehicle [kg]


class Scaled:
    """A law of a paper's world, flown in this one."""

    def __init__(self, law: Law, scale: Scale) -> None:
        self._law, self._mass, self.words = law, scale.mass, law.words
        self._length, self._time = scale.length, scale.time
        self._speed = scale.length / scale.time
        self._accel = scale.length / scale.time**2
        self._jerk = scale.length / scale.time**3

    def concerns(self, law_state: Array) -> list[Concern]:
        """What the law has to say of the flight, if it says anything."""
        say = getattr(self._law, "concerns", None)
        return [] if say is None else say(law_state)

    def _force(self, own: Body) -> float:
        """Paper's newtons per newton."""
        return self._accel * (self._mass or own.mass) / own.mass

    def _body(self, own: Body) -> Body:
        return Body(
            own.p * self._length,
            own.v * self._speed,
            self._mass or own.mass,
            own.drift * self._accel,
            own.drift_rate * self._jerk,
            own.max_force * self._force(own),
            own.who,
        )

    def _discs(self, discs: Discs) -> Discs:
        length = self._length
        return Discs(discs.p * length, discs.v * self._speed, discs.radius * length)

    def _others(self, others: Neighbours) -> Neighbours:
        """What the laws tell each other stays in the paper's units."""
        discs = self._discs(Discs(*others[:3]))
        return Neighbours(*discs, others.who, others.told, others.told_at * self._time)

    def _world(self, world: World) -> World:
        goal = world.goal
        return World(
            Goal(
                goal.p * self._length,
                goal.v * self._speed,
                goal.a * self._accel,
                goal.jerk * self._jerk,
            ),
            self._discs(world.obstacles),
        )

    def _scene(
        self, own: Body, neighbours: Neighbours, world: World
    ) -> tuple[Body, Neighbours, World]:
        return self._body(own), self._others(neighbours), self._world(world)

    def initial(self, own: Body, neighbours: Neighbours, world: World) -> Array:
        """See `Law`; the law's state stays in the paper's units."""
        return self._law.initial(*self._scene(own, neighbours, world))

    def rate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World, t: float
    ) -> tuple[Array, Array]:
        """See `Law`; force in newtons here, law state in the paper's units per second here."""
        force, change = self._law.rate(
            law_state, *self._scene(own, neighbours, world), t * self._time
        )
        return force / self._force(own), change * self._time

    def fly_ahead(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World,
        t: float, duration: float, steps: int,
    ) -> Ahead:  # fmt: skip
        """See `Law`."""
        ahead = self._law.fly_ahead(
            law_state, *self._scene(own, neighbours, world),
            t * self._time, duration * self._time, steps,
        )  # fmt: skip
        return Ahead(
            ahead.law_state,
            ahead.p / self._length,
            ahead.v / self._speed,
            ahead.mean_force / self._force(own),
            ahead.told,
        )
