"""Interface of control laws: their inputs, and the integration of their state.

A law of the papers is a small dynamical system written once, in continuous time:

    force, law_state_rate = rate(gains, law_state, own, neighbours, world, t)

or, without new arrays, writes both to its last two arguments (`law_verbs.compiled_rate`); with
positions of shape (d,), d = 2 on the table and d = 3 in orbit. The law does not integrate
its state; `propagate` does, together with a double integrator as the model of the satellite.

A law of a formation may have two more functions. `broadcast` sends a message to the others, for
instance the position of its proxy; messages may be late or lost, and a law knows of the others only
what it received. `jump` changes discrete parts of its state, for instance its neighbours in the
proximity graph.

Compiled code receives the tuples below. Their arrays belong to the caller and a law must not write
to them.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, TypeVar, cast

import numpy as np
from msgspec import Struct
from numba.extending import overload
from numpy.typing import NDArray

from testbed.core.compiled import borrowed, compiled, inlined, keep, with_fixed_types
from testbed.core.law_verbs import broadcast_of, jump_of, write_rate, writes
from testbed.core.law_verbs import compiled_broadcast as compiled_broadcast  # for users' laws
from testbed.core.law_verbs import compiled_jump as compiled_jump
from testbed.core.law_verbs import compiled_rate as compiled_rate
from testbed.core.scratch import scratch

Array = NDArray[np.float64]
F = TypeVar("F", bound=Callable[..., Any])


class Body(NamedTuple):
    """A satellite as its own law sees it.

    `disturbance` is the acceleration not caused by jets: orbit dynamics, or what the
    estimator sees.
    `max_force` bounds the norm of the force, so that a law with an integral does not wind up.
    """

    p: Array  # (d,) position [m]
    v: Array  # (d,) velocity [m/s]
    mass: float  # nominal [kg]
    disturbance: Array  # (d,) [m/s^2]
    disturbance_rate: Array  # (d,) its time derivative [m/s^3]
    max_force: float  # [N]
    vehicle_index: int = 0  # its index in the formation


class Goal(NamedTuple):
    """Goal of the satellite; derivatives are zero for a fixed goal."""

    p: Array  # (d,) [m]
    v: Array  # (d,) [m/s]
    a: Array  # (d,) [m/s^2]
    jerk: Array  # (d,) [m/s^3]


class Discs(NamedTuple):
    """Obstacles to stay away from."""

    p: Array  # (n, d) centre [m]
    v: Array  # (n, d) [m/s]
    radius: Array  # (n,) distance that the own centre must keep from the centre [m]


class Neighbours(NamedTuple):
    """The other satellites from which a state was received.

    Positions are extrapolated to now. Messages of their laws are not: only the law knows how to
    extrapolate them by `t - message_t` seconds.
    """

    p: Array  # (n, d) centre [m]
    v: Array  # (n, d) [m/s]
    radius: Array  # (n,) distance that the own centre must keep from the centre [m]
    vehicle_index: NDArray[np.int64]  # (n,) index of each in the formation
    message: Array  # (n, k) message of its law, k numbers by the law's own convention
    message_t: Array  # (n,) time of the message [s]


def silent(discs: Discs) -> Neighbours:
    """Neighbours without messages, numbered from 1."""
    n = len(discs.radius)
    return Neighbours(*discs, np.arange(1, n + 1), np.zeros((n, 0)), np.zeros(n))


class World(NamedTuple):
    """Goal and obstacles of the satellite."""

    goal: Goal
    obstacles: Discs


class Ahead(NamedTuple):
    """Result of flying a law ahead."""

    law_state: Array  # (n,)
    p: Array  # (d,) [m]
    v: Array  # (d,) [m/s]
    mean_force: Array  # (d,) over the flight [N]
    message: Array  # (k,) message of the law to the others at the end


class Concern(Struct, frozen=True):
    """A warning about a law for the operator; not an error."""

    name: str
    text: str


class Law(Protocol):
    """A control law of a paper, for one satellite."""

    message_size: int  # k, the numbers in its message to the others

    def initial(self, own: Body, neighbours: Neighbours, world: World) -> Array:
        """The law's state at the start, shape (n,); n may be 0."""
        ...

    def rate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World, t: float
    ) -> tuple[Array, Array]:
        """Force (d,) [N] and time derivative of the law's state (n,)."""
        ...

    def propagate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World,
        t: float, duration: float, steps: int,
    ) -> Ahead:  # fmt: skip
        """`propagate` below with this law's rate."""
        ...


def concerns_of(law: Any, law_state: Array) -> list[Concern]:
    """The law's concerns about the flight; laws without `concerns` have none."""
    concerns = getattr(law, "concerns", None)
    return [] if concerns is None else list(concerns(law_state))


def propagate_of(law, law_state, own, neighbours, world, t, duration, steps):
    """`propagate_in_plane`, or what is registered for laws with gains of this type."""
    fly = _PROPAGATES.get(type(law), propagate_in_plane)
    return fly(law, law_state, own, neighbours, world, t, duration, steps)


_PROPAGATES: dict[type, Callable] = {}  # by the type of a law's gains


@overload(propagate_of)
def _propagate_of(law, law_state, own, neighbours, world, t, duration, steps):
    fly = _PROPAGATES.get(law.instance_class, propagate_in_plane)
    return lambda law, law_state, own, neighbours, world, t, duration, steps: fly(
        law, law_state, own, neighbours, world, t, duration, steps
    )


def compiled_propagate(gains_type: type) -> Callable[[F], F]:
    """Compile what `propagate_of` calls for `gains_type` instead of `propagate_in_plane`."""

    def decorate(function: F) -> F:
        _PROPAGATES[gains_type] = compiled(function)
        return cast(F, _PROPAGATES[gains_type])

    return decorate


def no_state(own: Body) -> Array:
    """Initial state of a law without memory."""
    return np.zeros(0)


class CompiledLaw:
    """A law made of compiled functions and its gains."""

    def __init__(
        self,
        gains: NamedTuple,
        initial: Callable[[Body], Array],
        rate: Callable[..., Any],
        message_size: int = 0,
    ) -> None:
        self.gains, self._initial, self._rate = gains, initial, rate
        self.message_size, self._writes = message_size, writes(rate)
        self._propagate, self._in_plane = map(with_fixed_types, (propagate, propagate_in_plane))

    def for_compiled_code(self, mass: float) -> Any:
        """The law for `propagate_of`, for a vehicle of this mass [kg]; None: there is none."""
        return self.gains

    def initial(self, own: Body, neighbours: Neighbours, world: World) -> Array:
        """See `Law`."""
        return self._initial(own)

    def rate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World, t: float
    ) -> tuple[Array, Array]:
        """See `Law`."""
        if not self._writes:
            return self._rate(self.gains, law_state, own, neighbours, world, t)
        # what the law does not write stays NaN, which `testbed check` finds
        force, change = np.full(own.p.shape, np.nan), np.full(law_state.shape, np.nan)
        self._rate(self.gains, law_state, own, neighbours, world, t, force, change)
        return force, change

    def propagate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World,
        t: float, duration: float, steps: int,
    ) -> Ahead:  # fmt: skip
        """See `Law`."""
        fly = self._in_plane if own.p.shape[0] == 2 else self._propagate
        return fly(self.gains, law_state, own, neighbours, world, t, duration, steps)


@inlined
def bounded(force, limit):
    """`force` (d,), shortened to the norm `limit` if it is longer, direction kept."""
    square = 0.0
    for i in range(force.shape[0]):
        square += force[i] * force[i]
    return force * (limit / np.sqrt(square)) if square > limit * limit else force


@inlined
def shorten(force, limit):
    """Shorten `force` (d,) in place to the norm `limit` if it is longer, direction kept."""
    square = 0.0
    for i in range(force.shape[0]):
        square += force[i] * force[i]
    if square > limit * limit:
        factor = limit / np.sqrt(square)
        for i in range(force.shape[0]):
            force[i] *= factor


@compiled
def propagate(gains, law_state, own, neighbours, world, t, duration, steps):
    """Integrate a law and the double integrator p'' = force/mass + disturbance over `duration`.

    Between sub-steps the goal follows its derivatives, obstacles and neighbours keep their
    velocity, and the disturbance follows its rate. Within a sub-step the acceleration is constant,
    so position and velocity are exact for it; the law's state takes an Euler step, because a higher
    order does not help laws with sgn. `jump` comes at the start, `broadcast` at the end.

    Args:
        gains: of the law, registered with `compiled_rate`.
        law_state: shape (n,), at time `t`.
        own: the satellite at time `t`.
        neighbours: the others, extrapolated to time `t`.
        world: goal and obstacles at time `t`.
        t: start [s].
        duration: [s].
        steps: number of sub-steps, at least 1.

    Returns:
        the state at the end, the mean force and the law's message.
    """
    d = own.p.shape[0]
    return fly_ahead(d, gains, law_state, own, neighbours, world, t, duration, steps)


@compiled
def propagate_in_plane(gains, law_state, own, neighbours, world, t, duration, steps):
    """`propagate` for d = 2: the compiler knows the lengths of all loops, in the law's rate, too.

    The same arithmetic takes half the time.
    """
    return fly_ahead(2, gains, law_state, own, neighbours, world, t, duration, steps)


@inlined
def copy_to(copy, vector):
    """Write the first numbers of `vector` to `copy`."""
    for i in range(copy.shape[0]):
        copy[i] = vector[i]


@inlined
def fly_ahead(d, gains, law_state, own, neighbours, world, t, duration, steps):
    """See `propagate`; `d` is the number of axes."""
    h, goal, obstacles = duration / steps, world.goal, world.obstacles
    z = jump_of(gains, law_state, own, neighbours, world, t).copy()
    p, v, mean_force = np.empty(d), np.empty(d), np.zeros(d)
    disturbance, disturbance_rate, force = scratch(d), scratch(d), scratch(d)
    goal_p, goal_v, goal_a, jerk = scratch(d), scratch(d), scratch(d), scratch(d)
    copy_to(p, own.p)
    copy_to(v, own.v)
    copy_to(disturbance, own.disturbance)
    copy_to(disturbance_rate, own.disturbance_rate)
    copy_to(goal_p, goal.p)
    copy_to(goal_v, goal.v)
    copy_to(goal_a, goal.a)
    copy_to(jerk, goal.jerk)
    obstacles_p, others_p = scratch((obstacles.p.shape[0], d)), scratch((neighbours.p.shape[0], d))
    obstacles_p[:], others_p[:] = obstacles.p, neighbours.p
    z_rate = scratch(z.shape[0])
    body = borrowed(
        Body(p, v, own.mass, disturbance, disturbance_rate, own.max_force, own.vehicle_index)
    )
    others = borrowed(
        Neighbours(
            others_p, neighbours.v, neighbours.radius,
            neighbours.vehicle_index, neighbours.message, neighbours.message_t,
        )
    )  # fmt: skip
    target = Goal(goal_p, goal_v, goal_a, jerk)
    scene = borrowed(World(target, Discs(obstacles_p, obstacles.v, obstacles.radius)))
    gains, state = borrowed(gains), borrowed(z)
    for k in range(steps):
        write_rate(gains, state, body, others, scene, t + k * h, force, z_rate)
        for i in range(d):
            mean_force[i] += force[i] / steps
            a = force[i] / own.mass + disturbance[i]
            p[i] += h * (v[i] + 0.5 * h * a)
            v[i] += h * a
            disturbance[i] += h * disturbance_rate[i]
            goal_p[i] += h * (goal_v[i] + 0.5 * h * goal_a[i])
            goal_v[i] += h * goal_a[i]
            goal_a[i] += h * jerk[i]
            for n in range(obstacles_p.shape[0]):
                obstacles_p[n, i] += h * obstacles.v[n, i]
            for n in range(others_p.shape[0]):
                others_p[n, i] += h * neighbours.v[n, i]
        for i in range(z.shape[0]):
            z[i] += h * z_rate[i]
    message = broadcast_of(gains, state, body, others, scene, t + duration)
    keep((own, neighbours, world))
    return Ahead(z, p, v, mean_force, message)
