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

from testbed.core.compiled import compiled, with_fixed_types
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


@compiled
def discs_in(units, discs):
    """Discs in the paper's units."""
    return Discs(discs.p * units.length, discs.v * units.speed, discs.radius * units.length)


@compiled
def scene_in(units, own, neighbours, world):
    """Inputs of a law in the paper's units; the laws' messages already are."""
    goal, others = world.goal, neighbours
    body = Body(
        own.p * units.length,
        own.v * units.speed,
        units.mass,
        own.disturbance * units.accel,
        own.disturbance_rate * units.jerk,
        own.max_force * units.force,
        own.vehicle_index,
    )
    others = Neighbours(
        others.p * units.length,
        others.v * units.speed,
        others.radius * units.length,
        others.vehicle_index,
        others.message,
        others.message_t * units.time,
    )
    target = Goal(
        goal.p * units.length,
        goal.v * units.speed,
        goal.a * units.accel,
        goal.jerk * units.jerk,
    )
    return body, others, World(target, discs_in(units, world.obstacles))


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
    body, others, scene = scene_in(units, own, neighbours, world)
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

    def concerns(self, law_state: Array) -> list[Concern]:
        """See `concerns_of`."""
        return concerns_of(self.law, law_state)

    def initial(self, own: Body, neighbours: Neighbours, world: World) -> Array:
        """See `Law`; the law's state stays in the paper's units."""
        return self.law.initial(*scene_in(self._units(own.mass), own, neighbours, world))

    def rate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World, t: float
    ) -> tuple[Array, Array]:
        """See `Law`; force in table newtons, law state in paper units per table second."""
        units = self._units(own.mass)
        body, others, scene = scene_in(units, own, neighbours, world)
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
        body, others, scene = scene_in(units, own, neighbours, world)
        t, duration = t * units.time, duration * units.time
        ahead = law.propagate(law_state, body, others, scene, t, duration, steps)
        return home(units, ahead)
