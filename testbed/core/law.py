"""What a control law sees, and how its state moves in time.

A law of the papers is a small dynamical system written once, in continuous time:

    force, law_state_rate = rate(gains, law_state, own, neighbours, world, t)

with positions of shape (d,), d = 2 on the table and d = 3 in orbit. The law does not integrate
itself; `fly_ahead` does, together with the double integrator that a satellite is to first order.

The tuples here are what the compiled code is handed. Their arrays belong to the caller and a law
must not write to them.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from testbed.core.compiled import compiled

Array = NDArray[np.float64]


class Body(NamedTuple):
    """A satellite as its own law sees it.

    `drift` is the acceleration that no jet asked for: orbit dynamics, or the estimated disturbance.
    `max_force` bounds the norm of the force, so that a law with an integral does not wind up.
    """

    p: Array  # (d,) position [m]
    v: Array  # (d,) velocity [m/s]
    mass: float  # nominal [kg]
    drift: Array  # (d,) [m/s^2]
    drift_rate: Array  # (d,) its time derivative [m/s^3]
    max_force: float  # [N]


class Goal(NamedTuple):
    """Where the satellite should be; derivatives are zero for a fixed goal."""

    p: Array  # (d,) [m]
    v: Array  # (d,) [m/s]
    a: Array  # (d,) [m/s^2]
    jerk: Array  # (d,) [m/s^3]


class Discs(NamedTuple):
    """Things to stay away from: obstacles, or neighbours as they were heard."""

    p: Array  # (n, d) centre [m]
    v: Array  # (n, d) [m/s]
    radius: Array  # (n,) distance that the own centre must keep from the centre [m]


class World(NamedTuple):
    """What surrounds the satellite."""

    goal: Goal
    obstacles: Discs


class Ahead(NamedTuple):
    """Where a law takes a satellite."""

    law_state: Array  # (n,)
    p: Array  # (d,) [m]
    v: Array  # (d,) [m/s]
    mean_force: Array  # (d,) over the flight [N]


class Law(Protocol):
    """A control law of a paper, for one satellite."""

    def initial(self, own: Body, neighbours: Discs, world: World) -> Array:
        """The law's state at the start, shape (n,); n may be 0."""
        ...

    def rate(
        self, law_state: Array, own: Body, neighbours: Discs, world: World, t: float
    ) -> tuple[Array, Array]:
        """Force (d,) [N] and time derivative of the law's state (n,)."""
        ...

    def fly_ahead(
        self, law_state: Array, own: Body, neighbours: Discs, world: World,
        t: float, duration: float, steps: int,
    ) -> Ahead:  # fmt: skip
        """`fly_ahead` below with this law's rate."""
        ...


def rate_of(law, law_state, own, neighbours, world, t):
    """Force and rate of a law's state; compiled code picks the law by the type of its gains.

    Here is the plain Python case, where `law` is an object with a method `rate`.
    """
    return law.rate(law_state, own, neighbours, world, t)


def compiled_rate(gains_type: type) -> Callable[[Callable], Callable]:
    """Compile a law's rate function and make it the one that `rate_of` means by `gains_type`.

    A function argument would do the same, but numba cannot keep a function that was handed
    another one on disk.
    """

    def decorate(function: Callable) -> Callable:
        kernel = compiled(function)

        @overload(rate_of, jit_options={"forceinline": True})  # the arguments are many words
        def choose(law, law_state, own, neighbours, world, t):
            if isinstance(law, types.BaseNamedTuple) and law.instance_class is gains_type:
                return lambda law, law_state, own, neighbours, world, t: kernel(
                    law, law_state, own, neighbours, world, t
                )
            return None

        return kernel

    return decorate


def no_state(own: Body) -> Array:
    """Initial state of a law without memory."""
    return np.zeros(0)


class CompiledLaw:
    """A law made of a compiled rate and its gains."""

    def __init__(
        self, gains: NamedTuple, initial: Callable[[Body], Array], rate: Callable[..., Any]
    ) -> None:
        self._gains, self._initial, self._rate = gains, initial, rate

    def initial(self, own: Body, neighbours: Discs, world: World) -> Array:
        """See `Law`."""
        return self._initial(own)

    def rate(
        self, law_state: Array, own: Body, neighbours: Discs, world: World, t: float
    ) -> tuple[Array, Array]:
        """See `Law`."""
        return self._rate(self._gains, law_state, own, neighbours, world, t)

    def fly_ahead(
        self, law_state: Array, own: Body, neighbours: Discs, world: World,
        t: float, duration: float, steps: int,
    ) -> Ahead:  # fmt: skip
        """See `Law`."""
        return fly_ahead(self._gains, law_state, own, neighbours, world, t, duration, steps)


@compiled
def bounded(force, limit):
    """`force` (d,), shortened to the norm `limit` if it is longer, direction kept."""
    size = np.sqrt(np.sum(force * force))
    return force * (limit / size) if size > limit else force


@compiled
def fly_ahead(gains, law_state, own, neighbours, world, t, duration, steps):
    """Integrate a law and the double integrator p'' = force/mass + drift over `duration`.

    Between sub-steps the goal follows its derivatives, obstacles and neighbours keep their
    velocity, and the drift follows its rate. Within a sub-step the acceleration is constant, so
    position and velocity are exact for it; the law's state takes an Euler step, because the laws
    with sgn gain nothing from a higher order.

    Args:
        gains: the law, as `rate_of` knows it.
        law_state: shape (n,), at time `t`.
        own: the satellite at time `t`.
        neighbours: the others, extrapolated to time `t`.
        world: goal and obstacles at time `t`.
        t: start [s].
        duration: [s].
        steps: number of sub-steps, at least 1.

    Returns:
        the end of the flight.
    """
    h = duration / steps
    z = law_state.copy()
    p, v = own.p.copy(), own.v.copy()
    drift = own.drift.copy()
    goal_p, goal_v, goal_a = world.goal.p.copy(), world.goal.v.copy(), world.goal.a.copy()
    rocks_p, others_p = world.obstacles.p.copy(), neighbours.p.copy()
    body = Body(p, v, own.mass, drift, own.drift_rate, own.max_force)
    others = Discs(others_p, neighbours.v, neighbours.radius)
    scene = World(
        Goal(goal_p, goal_v, goal_a, world.goal.jerk),
        Discs(rocks_p, world.obstacles.v, world.obstacles.radius),
    )
    mean_force = np.zeros(p.shape[0])
    for k in range(steps):
        force, z_rate = rate_of(gains, z, body, others, scene, t + k * h)
        for i in range(p.shape[0]):
            mean_force[i] += force[i] / steps
            a = force[i] / own.mass + drift[i]
            p[i] += h * (v[i] + 0.5 * h * a)
            v[i] += h * a
            drift[i] += h * own.drift_rate[i]
            goal_p[i] += h * (goal_v[i] + 0.5 * h * goal_a[i])
            goal_v[i] += h * goal_a[i]
            goal_a[i] += h * world.goal.jerk[i]
            for n in range(rocks_p.shape[0]):
                rocks_p[n, i] += h * world.obstacles.v[n, i]
            for n in range(others_p.shape[0]):
                others_p[n, i] += h * neighbours.v[n, i]
        for i in range(z.shape[0]):  # last: the force may be a view of the law's state
            z[i] += h * z_rate[i]
    return Ahead(z, p, v, mean_force)
