"""Conversion between a paper's units and the table's: an adapter around any law.

zhang2023 reuses its space parameters on the table, where 50 m become 0.8 m. With a length scale L
and a time scale T

    position_paper = L position        velocity_paper = L/T velocity
    time_paper     = T time            acceleration   = T^2/L acceleration_paper

and the nominal mass of the paper's satellite replaces the vehicle's.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from testbed.core.compiled import compiled, inlined, with_fixed_types
from testbed.core.law import (
    Ahead,
    Body,
    CompiledLaw,
    Concern,
    Discs,
    Goal,
    Law,
    Neighbours,
    World,
    compiled_propagate,
    concerns_of,
    propagate_in_plane,
)
from testbed.core.scratch import scratch
from testbed.core.vehicle import Positive

Array = NDArray[np.float64]


class Scale(Struct, frozen=True, forbid_unknown_fields=True):
    """Scales from the table to the paper's units; by default the same units."""

    length: Positive = 1.0  # L
    time: Positive = 1.0  # T
    mass: Positive | None = None  # of the paper's satellite; null: the vehicle's [kg]


class Units(NamedTuple):
    """One unit of the table in the paper's units."""

    length: float
    speed: float
    accel: float
    jerk: float
    time: float
    force: float
    mass: float  # of the paper's satellite [kg]


class Room(NamedTuple):
    """Memory for a law's inputs in the paper's units."""

    own: Array  # (4, d)
    goal: Array  # (4, d)
    others: Array  # (2, n, d)
    of_others: Array  # (2, n)
    discs: Array  # (2, m, d)
    radius: Array  # (m,)


def room_for(neighbours: Neighbours, world: World) -> Room:
    """Memory on the heap, for callers in Python."""
    (n, d), m = neighbours.p.shape, len(world.obstacles.p)
    return Room(*(np.empty(one) for one in ((4, d), (4, d), (2, n, d), (2, n), (2, m, d), (m,))))


@inlined
def times(numbers, factor, out):
    """`numbers` times `factor`, written to `out`."""
    np.multiply(numbers, factor, out)
    return out


@compiled
def scene_in(units, own, neighbours, world, room):
    """Inputs of a law in the paper's units; the laws' messages already are."""
    length, speed, accel, jerk = units.length, units.speed, units.accel, units.jerk
    goal, others, discs = world.goal, neighbours, world.obstacles
    body = Body(
        times(own.p, length, room.own[0]),
        times(own.v, speed, room.own[1]),
        units.mass,
        times(own.disturbance, accel, room.own[2]),
        times(own.disturbance_rate, jerk, room.own[3]),
        own.max_force * units.force,
        own.vehicle_index,
    )
    others = Neighbours(
        times(others.p, length, room.others[0]),
        times(others.v, speed, room.others[1]),
        times(others.radius, length, room.of_others[0]),
        others.vehicle_index,
        others.message,
        times(others.message_t, units.time, room.of_others[1]),
    )
    target = Goal(
        times(goal.p, length, room.goal[0]),
        times(goal.v, speed, room.goal[1]),
        times(goal.a, accel, room.goal[2]),
        times(goal.jerk, jerk, room.goal[3]),
    )
    obstacles = Discs(
        times(discs.p, length, room.discs[0]),
        times(discs.v, speed, room.discs[1]),
        times(discs.radius, length, room.radius),
    )
    return body, others, World(target, obstacles)


@compiled
def home(units, ahead):
    """A law's prediction converted back to the table's units."""
    return Ahead(
        ahead.law_state,
        ahead.p / units.length,
        ahead.v / units.speed,
        ahead.mean_force / units.force,
        ahead.message,
    )


class InUnits(NamedTuple):
    """A law's gains, and the units that it flies in."""

    gains: Any
    units: Units


@compiled_propagate(InUnits)
def fly_scaled(law, law_state, own, neighbours, world, t, duration, steps):
    """`propagate_in_plane` in the paper's units, in one call of compiled code."""
    gains, units = law
    n, m = neighbours.p.shape[0], world.obstacles.p.shape[0]
    room = Room(
        scratch((4, 2)), scratch((4, 2)), scratch((2, n, 2)), scratch((2, n)),
        scratch((2, m, 2)), scratch(m),
    )  # fmt: skip
    body, others, scene = scene_in(units, own, neighbours, world, room)
    t, duration = t * units.time, duration * units.time
    ahead = propagate_in_plane(gains, law_state, body, others, scene, t, duration, steps)
    return home(units, ahead)


class Scaled:
    """A law in a paper's units, flown on the table."""

    def __init__(self, law: Law, scale: Scale) -> None:
        self.law, self._mass, self.message_size = law, scale.mass, law.message_size
        self._units = lru_cache(maxsize=8)(self._units_of)
        length, time = scale.length, scale.time
        self._rates = length, length / time, length / time**2, length / time**3, time
        self._fly_scaled = with_fixed_types(fly_scaled)

    def for_compiled_code(self, mass: float) -> Any:
        """See `CompiledLaw`."""
        law = self.law
        return InUnits(law.gains, self._units(mass)) if isinstance(law, CompiledLaw) else None

    def _units_of(self, vehicle: float) -> Units:
        """Units for a vehicle of this mass [kg]."""
        mass = self._mass or vehicle
        length, speed, accel, jerk, time = self._rates
        return Units(length, speed, accel, jerk, time, accel * mass / vehicle, mass)

    def _scene(
        self, own: Body, neighbours: Neighbours, world: World
    ) -> tuple[Body, Neighbours, World]:
        units = self._units(own.mass)
        return scene_in(units, own, neighbours, world, room_for(neighbours, world))

    def concerns(self, law_state: Array) -> list[Concern]:
        """See `concerns_of`."""
        return concerns_of(self.law, law_state)

    def initial(self, own: Body, neighbours: Neighbours, world: World) -> Array:
        """See `Law`; the law's state stays in the paper's units."""
        return self.law.initial(*self._scene(own, neighbours, world))

    def rate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World, t: float
    ) -> tuple[Array, Array]:
        """See `Law`; force in table newtons, law state in paper units per table second."""
        units = self._units(own.mass)
        body, others, scene = self._scene(own, neighbours, world)
        force, change = self.law.rate(law_state, body, others, scene, t * units.time)
        return force / units.force, change * units.time

    def propagate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World,
        t: float, duration: float, steps: int,
    ) -> Ahead:  # fmt: skip
        """See `Law`."""
        units, law = self._units(own.mass), self.law
        if isinstance(law, CompiledLaw) and own.p.shape[0] == 2:
            scaled = InUnits(law.gains, units)
            return self._fly_scaled(scaled, law_state, own, neighbours, world, t, duration, steps)
        body, others, scene = self._scene(own, neighbours, world)
        t, duration = t * units.time, duration * units.time
        ahead = law.propagate(law_state, body, others, scene, t, duration, steps)
        return home(units, ahead)
