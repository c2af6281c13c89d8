r"""Proxies: the common part of the laws for bounded actuation.

Sources: X. Xue, X. Yue, J. Yuan, "Connectivity preservation and collision avoidance control for
spacecraft formation flying with bounded actuation", ICGNC 2020, Springer 2022; X. Xue, X. Wang,
N. Han, "Leader-following connectivity preservation and collision avoidance control for multiple
spacecraft with bounded actuation", Aerospace 11:612, 2024. Equation numbers are those of 2024.

Each satellite simulates a virtual satellite, its proxy, on which the full force of the potential
acts. A spring that saturates couples the satellite to its proxy, so the satellite's force stays
bounded.

    paper                code              meaning                                       unit
    p_i, p_i'            own.p, own.v      the satellite                                 m, m/s
    p_i hat              law_state[:d]     its proxy                                     m
    p_i hat'             law_state[d:2d]   its velocity                                  m/s
    a_ij                 law_state[2d:]    edges, the leader's last, see `graph`         -
    rho; alpha in 2022   spring            stiffness between satellite and proxy         N/m
    bound of Sat         limit             of the spring, each axis                      N
    P                    weight            of the potential                              N/m
    Q                    height            of the potential                              m^2
    1                    mass              of the proxy                                  kg
    m_i g_i (+ m_i C p') own.mass*own.disturbance force on the satellite without thrust        N

All three papers imply a proxy mass of 1 kg: they add a force to an acceleration. It is a parameter
here because it must be scaled with the rest.

Differences from the papers: the others broadcast their proxies, which are extrapolated to now with
their velocity; otherwise the proxies of a moving formation would lag and pull. `obstacle_band` is
an addition, 0 as in the papers: obstacles repel the proxy within this distance of their radius. The
proofs extend to it for obstacles that stand still, but not together with a moving leader. The
spring's limit applies to each axis, own.max_force to the norm of the total force, which is limited
last; that limit never acts if the spring's limit is below own.max_force/sqrt(d) less mass times
drift.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from controllers.bounded_potential import BoundedPotential, bounded_potential
from controllers.graph import Formation, FormationParams, distance, formation, remember
from testbed.core.compiled import compiled
from testbed.core.error import MismatchError
from testbed.core.law import Body
from testbed.core.law_verbs import compiled_broadcast, compiled_jump
from testbed.core.vehicle import NonNegative, Positive

Array = NDArray[np.float64]


class ProxyParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Spring and potential, in the paper's units."""

    spring: Positive  # [N/m]
    limit: Positive  # [N]
    weight: Positive  # P [N/m]
    height: Positive  # Q [m^2]
    mass: Positive = 1.0  # [kg]
    obstacle_band: NonNegative = 0.0  # [m]


class Coupling(NamedTuple):
    """Parameters and formation for compiled code."""

    formation: Formation
    potential: BoundedPotential
    spring: float
    limit: float
    weight: float
    mass: float
    band: float  # [m]
    margin: float  # epsilon_2 [m]


def coupling(
    params: ProxyParams, shape: FormationParams, names: Sequence[str], led: bool
) -> Coupling:
    """Convert the parameters for compiled code."""
    if 0.0 < params.obstacle_band <= shape.near_margin:
        raise MismatchError(
            f"0 or more than near_margin = {shape.near_margin:g} m",
            f"{params.obstacle_band:g} m",
            "obstacle_band",
        )
    return Coupling(
        formation(shape, names, led),
        BoundedPotential(shape.near, shape.far, params.height),
        params.spring,
        params.limit,
        params.weight,
        params.mass,
        params.obstacle_band,
        shape.near_margin,
    )


def start(c: Coupling, own: Body) -> Array:
    """Initial state: proxy at rest at the satellite, Eq. (10) of 2022, and the edges of E(0)."""
    return np.concatenate((own.p, np.zeros_like(own.p), c.formation.first[own.vehicle_index]))


@compiled
def saturated(x, limit):
    """`x` with each axis limited to [-limit, limit]."""
    return np.minimum(np.maximum(x, -limit), limit)


@compiled
def soft_sign(x, layer):
    """The sgn of each axis, linear inside the boundary layer."""
    return np.sign(x) if layer == 0.0 else np.minimum(np.maximum(x / layer, -1.0), 1.0)


@compiled
def is_edge(law_state, d, j):
    """Whether a_ij = 1; j < 0 is a vehicle outside the formation."""
    return j >= 0 and law_state[2 * d + j] > 0.5


@compiled
def heard_proxy(neighbours, k, t, d):
    """Position and velocity of the k-th neighbour's proxy now, shape (2, d).

    If the neighbour's law has sent no message, the neighbour itself is taken as its proxy.
    """
    q = np.empty((2, d))
    has_message = neighbours.message.shape[1] >= 2 * d
    late = t - neighbours.message_t[k]
    for i in range(d):
        if has_message:
            q[1, i] = neighbours.message[k, d + i]
            q[0, i] = neighbours.message[k, i] + late * q[1, i]
        else:
            q[0, i], q[1, i] = neighbours.p[k, i], neighbours.v[k, i]
    return q


@compiled
def descend(potential, weight, here, there, desired, total):
    """Add to `total` the force of one potential on the proxy `here`."""
    x = distance(here, there)
    if x == 0.0:
        return  # the direction is undefined
    slope = bounded_potential(potential, x, desired)[1]
    for i in range(here.shape[0]):
        total[i] -= weight * slope * (here[i] - there[i]) / x


@compiled
def potential_force(c, law_state, own, neighbours, world, t):
    """Force on the proxy, -sum_j a_ij grad_i P psi and repulsion of obstacles, (d,) [N]."""
    d = own.p.shape[0]
    here, total = law_state[:d], np.zeros(d)
    me, n = own.vehicle_index, c.formation.desired.shape[0] - 1
    for k in range(neighbours.p.shape[0]):
        j = neighbours.vehicle_index[k]
        if is_edge(law_state, d, j):
            there = heard_proxy(neighbours, k, t, d)[0]
            descend(c.potential, c.weight, here, there, c.formation.desired[me, j], total)
    if is_edge(law_state, d, n):  # the leader is its own proxy
        descend(c.potential, c.weight, here, world.goal.p, c.formation.desired[me, n], total)
    if c.band > 0.0:
        for k in range(world.obstacles.p.shape[0]):
            radius = world.obstacles.radius[k]
            wall = BoundedPotential(radius + c.margin, c.potential.far, c.potential.height)
            if distance(here, world.obstacles.p[k]) < radius + c.band:
                there = world.obstacles.p[k]
                descend(wall, c.weight, here, there, radius + c.band, total)
    return total


def _jump(gains, law_state, own, neighbours, world, t):
    """Update the edges from real positions."""
    return remember(gains.coupling.formation, law_state, 2 * own.p.shape[0], own, neighbours, world)


def _broadcast(gains, law_state, own, neighbours, world, t):
    """Broadcast position and velocity of the proxy."""
    return law_state[: 2 * own.p.shape[0]].copy()


def with_proxy(gains_type: type) -> tuple[Callable, Callable]:
    """`jump` and `broadcast` of a law with a proxy, whose gains have a `coupling`."""
    return compiled_jump(gains_type)(_jump), compiled_broadcast(gains_type)(_broadcast)
