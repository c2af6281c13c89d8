"""Interface of control laws: their inputs, and the integration of their state.

A law of the papers is a small dynamical system written once, in continuous time:

    force, law_state_rate = rate(gains, law_state, own, neighbours, world, t)

with positions of shape (d,), d = 2 on the table and d = 3 in orbit. The law does not integrate
its state; `propagate` does, together with a double integrator as the model of the satellite.

A law of a formation may have two more functions. `broadcast` sends a message to the others, for
instance the position of its proxy; messages may be late or lost, and a law knows of the others only
what it received. `jump` changes discrete parts of its state, for instance its neighbours in the
proximity graph.

Compiled code receives the tuples below. Their arrays belong to the caller and a law must not write
to them.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, Protocol, TypeVar, cast

import numpy as np
from msgspec import Struct
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from testbed.core.compiled import borrowed, compiled, inlined, keep, with_fixed_types

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


def rate_of(law, law_state, own, neighbours, world, t):
    """Force and rate of a law's state; the law is selected by the type of its gains.

    This is the plain Python version, where `law` may also be an object with a method `rate`.
    """
    return _plain(_RATES, law, "rate")(law_state, own, neighbours, world, t)


def jump_of(law, law_state, own, neighbours, world, t):
    """A law's state after a jump of its discrete parts; most laws have none."""
    jump = _plain(_JUMPS, law, "jump")
    return law_state if jump is None else jump(law_state, own, neighbours, world, t)


def broadcast_of(law, law_state, own, neighbours, world, t):
    """A law's message to the others, shape (k,); most laws send none."""
    broadcast = _plain(_BROADCASTS, law, "broadcast")
    return np.zeros(0) if broadcast is None else broadcast(law_state, own, neighbours, world, t)


def _plain(table: dict[type, Callable], law: Any, verb: str) -> Any:
    """A law's function: registered for its gains, or the law's own method; None: it has none."""
    found = table.get(type(law))
    return getattr(law, verb, None) if found is None else partial(found, law)


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
    """Make compiled code look up a function in `table` by the type of a law's gains."""

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


def compiled_rate(gains_type: type) -> Callable[[F], F]:
    """Compile a law's rate and register it in `rate_of` for `gains_type`.

    A function argument would do the same, but numba cannot cache a function on disk that takes a
    function as an argument.
    """
    return _compiled_into(_RATES, gains_type)


def compiled_jump(gains_type: type) -> Callable[[F], F]:
    """Compile a law's jump, which returns a new array, and register it in `jump_of`."""
    return _compiled_into(_JUMPS, gains_type)


def compiled_broadcast(gains_type: type) -> Callable[[F], F]:
    """Compile a law's broadcast and register it in `broadcast_of`."""
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
        self.gains, self._initial, self._rate = gains, initial, rate
        self.message_size = message_size
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
        return self._rate(self.gains, law_state, own, neighbours, world, t)

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
def copied(vector, d):
    """The first `d` numbers of `vector`."""
    copy = np.empty(d)
    for i in range(d):
        copy[i] = vector[i]
    return copy


@inlined
def fly_ahead(d, gains, law_state, own, neighbours, world, t, duration, steps):
    """See `propagate`; `d` is the number of axes."""
    h, goal = duration / steps, world.goal
    z = jump_of(gains, law_state, own, neighbours, world, t).copy()
    p, v, disturbance = copied(own.p, d), copied(own.v, d), copied(own.disturbance, d)
    disturbance_rate, jerk = copied(own.disturbance_rate, d), copied(goal.jerk, d)
    goal_p, goal_v, goal_a = copied(goal.p, d), copied(goal.v, d), copied(goal.a, d)
    obstacles_p = np.empty((world.obstacles.p.shape[0], d))
    others_p = np.empty((neighbours.p.shape[0], d))
    obstacles_p[:], others_p[:] = world.obstacles.p, neighbours.p
    body = borrowed(
        Body(p, v, own.mass, disturbance, disturbance_rate, own.max_force, own.vehicle_index)
    )
    others = borrowed(
        Neighbours(
            others_p, neighbours.v, neighbours.radius,
            neighbours.vehicle_index, neighbours.message, neighbours.message_t,
        )
    )  # fmt: skip
    scene = borrowed(
        World(
            Goal(goal_p, goal_v, goal_a, jerk),
            Discs(obstacles_p, world.obstacles.v, world.obstacles.radius),
        )
    )
    gains, state = borrowed(gains), borrowed(z)
    mean_force = np.zeros(d)
    for k in range(steps):
        force, z_rate = rate_of(gains, state, body, others, scene, t + k * h)
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
                obstacles_p[n, i] += h * world.obstacles.v[n, i]
            for n in range(others_p.shape[0]):
                others_p[n, i] += h * neighbours.v[n, i]
        for i in range(z.shape[0]):  # last, because the force may be a view of the law's state
            z[i] += h * z_rate[i]
    message = broadcast_of(gains, state, body, others, scene, t + duration)
    keep((own, neighbours, world, disturbance, disturbance_rate))
    keep((goal_p, goal_v, goal_a, jerk, obstacles_p, others_p))
    return Ahead(z, p, v, mean_force, message)
