"""What a control law sees, and how its state moves in time.

A law of the papers is a small dynamical system written once, in continuous time:

    force, law_state_rate = rate(gains, law_state, own, neighbours, world, t)

with positions of shape (d,), d = 2 on the table and d = 3 in orbit. The law does not integrate
itself; `propagate` does, together with the double integrator that a satellite is to first order.

A law of a formation may have two verbs more. It may `broadcast` something to the others, for
instance where its proxy is; they hear it late or not at all, and a law never sees more of the
others than what it heard. And it may `jump`: change what it remembers that is not continuous, for
instance who is its neighbour in the proximity graph.

The tuples here are what the compiled code is handed. Their arrays belong to the caller and a law
must not write to them.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, TypeVar, cast

import numpy as np
from msgspec import Struct
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from testbed.core.compiled import borrowed, compiled, inlined, keep, settled

Array = NDArray[np.float64]
F = TypeVar("F", bound=Callable[..., Any])


class Body(NamedTuple):
    """A satellite as its own law sees it.

    `disturbance` is the acceleration that no jet asked for: orbit dynamics, or what the
    estimator sees.
    `max_force` bounds the norm of the force, so that a law with an integral does not wind up.
    """

    p: Array  # (d,) position [m]
    v: Array  # (d,) velocity [m/s]
    mass: float  # nominal [kg]
    disturbance: Array  # (d,) [m/s^2]
    disturbance_rate: Array  # (d,) its time derivative [m/s^3]
    max_force: float  # [N]
    vehicle_index: int = 0  # which of the formation it is


class Goal(NamedTuple):
    """Where the satellite should be; derivatives are zero for a fixed goal."""

    p: Array  # (d,) [m]
    v: Array  # (d,) [m/s]
    a: Array  # (d,) [m/s^2]
    jerk: Array  # (d,) [m/s^3]


class Discs(NamedTuple):
    """Things to stay away from."""

    p: Array  # (n, d) centre [m]
    v: Array  # (n, d) [m/s]
    radius: Array  # (n,) distance that the own centre must keep from the centre [m]


class Neighbours(NamedTuple):
    """The others as they were heard; one that was never heard is not among them.

    Positions are carried forward to now. What their laws told is as it was said: only the law
    knows how that moves, `t - message_t` seconds on.
    """

    p: Array  # (n, d) centre [m]
    v: Array  # (n, d) [m/s]
    radius: Array  # (n,) distance that the own centre must keep from the centre [m]
    vehicle_index: NDArray[np.int64]  # (n,) which of the formation each is
    message: Array  # (n, k) what its law said, k numbers by the law's own convention
    message_t: Array  # (n,) the time that this is for [s]


def silent(discs: Discs) -> Neighbours:
    """Neighbours of whom only the movement is known, numbered from 1."""
    n = len(discs.radius)
    return Neighbours(*discs, np.arange(1, n + 1), np.zeros((n, 0)), np.zeros(n))


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
    message: Array  # (k,) what the law says to the others at the end


class Concern(Struct, frozen=True):
    """Something about a law that whoever flies it should know; no error."""

    name: str
    text: str


class Law(Protocol):
    """A control law of a paper, for one satellite."""

    message_size: int  # how many numbers it tells the others, k

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


def rate_of(law, law_state, own, neighbours, world, t):
    """Force and rate of a law's state; compiled code picks the law by the type of its gains.

    Here is the plain Python case, where `law` is an object with a method `rate`.
    """
    return law.rate(law_state, own, neighbours, world, t)


def jump_of(law, law_state, own, neighbours, world, t):
    """A law's state after what changes at once; most laws have nothing of the kind."""
    return law.jump(law_state, own, neighbours, world, t) if hasattr(law, "jump") else law_state


def broadcast_of(law, law_state, own, neighbours, world, t):
    """What a law says to the others, shape (k,); most laws need no more than is seen of them."""
    return (
        law.broadcast(law_state, own, neighbours, world, t)
        if hasattr(law, "broadcast")
        else np.zeros(0)
    )


_RATES: dict[type, Callable] = {}  # by the type of a law's gains
_JUMPS: dict[type, Callable] = {}
_BROADCASTS: dict[type, Callable] = {}


@compiled
def _keep(law, law_state, own, neighbours, world, t):
    return law_state


@compiled
def _say_nothing(law, law_state, own, neighbours, world, t):
    return np.empty(0)


def _dispatch(verb: Callable, table: dict[type, Callable], default: Callable | None) -> None:
    """Make compiled code look a verb up in `table`, by the type of a law's gains."""

    @overload(verb, jit_options={"forceinline": True})  # the arguments are many words
    def choose(law, law_state, own, neighbours, world, t):
        known = isinstance(law, types.BaseNamedTuple)
        kernel = table.get(law.instance_class, default) if known else None
        if kernel is None:
            return None
        return lambda law, law_state, own, neighbours, world, t: kernel(
            law, law_state, own, neighbours, world, t
        )


_dispatch(rate_of, _RATES, None)
_dispatch(jump_of, _JUMPS, _keep)
_dispatch(broadcast_of, _BROADCASTS, _say_nothing)


def _compiled_into(table: dict[type, Callable], gains_type: type) -> Callable[[F], F]:
    def decorate(function: F) -> F:
        table[gains_type] = inlined(function)
        return cast(F, table[gains_type])

    return decorate


def compiled_rate(gains_type: type) -> Callable[[F], F]:
    """Compile a law's rate and make it the one that `rate_of` means by `gains_type`.

    A function argument would do the same, but numba cannot keep a function that was handed
    another one on disk.
    """
    return _compiled_into(_RATES, gains_type)


def compiled_jump(gains_type: type) -> Callable[[F], F]:
    """The same for `jump_of`; the function returns a new array."""
    return _compiled_into(_JUMPS, gains_type)


def compiled_broadcast(gains_type: type) -> Callable[[F], F]:
    """The same for `broadcast_of`."""
    return _compiled_into(_BROADCASTS, gains_type)


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
        self.gains, self._initial, self._rate, self.message_size = (
            gains,
            initial,
            rate,
            message_size,
        )
        self._propagate = settled(propagate)

    def initial(self, own: Body, neighbours: Neighbours, world: World) -> Array:
        """See `Law`."""
        return self._initial(own)

    def rate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World, t: float
    ) -> tuple[Array, Array]:
        """See `Law`."""
        return self._rate(self.gains, law_state, own, neighbours, world, t)

    def propagate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World,
        t: float, duration: float, steps: int,
    ) -> Ahead:  # fmt: skip
        """See `Law`."""
        return self._propagate(self.gains, law_state, own, neighbours, world, t, duration, steps)


@inlined
def bounded(force, limit):
    """`force` (d,), shortened to the norm `limit` if it is longer, direction kept."""
    square = 0.0
    for i in range(force.shape[0]):
        square += force[i] * force[i]
    return force * (limit / np.sqrt(square)) if square > limit * limit else force


@compiled
def propagate(gains, law_state, own, neighbours, world, t, duration, steps):
    """Integrate a law and the double integrator p'' = force/mass + disturbance over `duration`.

    Between sub-steps the goal follows its derivatives, obstacles and neighbours keep their
    velocity, and the disturbance follows its rate. Within a sub-step the acceleration is constant,
    so position and velocity are exact for it; the law's state takes an Euler step, because the laws
    with sgn gain nothing from a higher order. The law jumps at the start and tells at the end.

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
    z = jump_of(gains, law_state, own, neighbours, world, t).copy()
    p, v = own.p.copy(), own.v.copy()
    disturbance = own.disturbance.copy()
    goal_p, goal_v, goal_a = world.goal.p.copy(), world.goal.v.copy(), world.goal.a.copy()
    obstacles_p, others_p = world.obstacles.p.copy(), neighbours.p.copy()
    body = borrowed(
        Body(p, v, own.mass, disturbance, own.disturbance_rate, own.max_force, own.vehicle_index)
    )
    others = borrowed(
        Neighbours(
            others_p, neighbours.v, neighbours.radius,
            neighbours.vehicle_index, neighbours.message, neighbours.message_t,
        )
    )  # fmt: skip
    scene = borrowed(
        World(
            Goal(goal_p, goal_v, goal_a, world.goal.jerk),
            Discs(obstacles_p, world.obstacles.v, world.obstacles.radius),
        )
    )
    gains, state = borrowed(gains), borrowed(z)
    mean_force = np.zeros(p.shape[0])
    for k in range(steps):
        force, z_rate = rate_of(gains, state, body, others, scene, t + k * h)
        for i in range(p.shape[0]):
            mean_force[i] += force[i] / steps
            a = force[i] / own.mass + disturbance[i]
            p[i] += h * (v[i] + 0.5 * h * a)
            v[i] += h * a
            disturbance[i] += h * own.disturbance_rate[i]
            goal_p[i] += h * (goal_v[i] + 0.5 * h * goal_a[i])
            goal_v[i] += h * goal_a[i]
            goal_a[i] += h * world.goal.jerk[i]
            for n in range(obstacles_p.shape[0]):
                obstacles_p[n, i] += h * world.obstacles.v[n, i]
            for n in range(others_p.shape[0]):
                others_p[n, i] += h * neighbours.v[n, i]
        for i in range(z.shape[0]):  # last: the force may be a view of the law's state
            z[i] += h * z_rate[i]
    message = broadcast_of(gains, state, body, others, scene, t + duration)
    keep((own, neighbours, world, disturbance, goal_p, goal_v, goal_a, obstacles_p, others_p))
    return Ahead(z, p, v, mean_force, message)
