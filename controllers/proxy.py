r"""Proxies: what the laws for bounded actuation share.

Sources: X. Xue, X. Yue, J. Yuan, "Connectivity preservation and collision avoidance control for
spacecraft formation flying with bounded actuation", ICGNC 2020, Springer 2022; X. Xue, X. Wang,
N. Han, "Leader-following connectivity preservation and collision avoidance control for multiple
spacecraft with bounded actuation", Aerospace 11:612, 2024. Equation numbers are those of 2024.

Each satellite computes a second one, its proxy, that moves under forces as large as the potential
wants. A spring that saturates ties the satellite to it, so the satellite's force stays bounded.

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
    m_i g_i (+ m_i C p') own.mass*own.disturbance what moves the satellite without a jet       N

A proxy's mass is 1 kg in all three papers without being mentioned: they add a force to an
acceleration. It is named here because it must be scaled with the rest.

Differences from the papers: the others' proxies are what they told, carried forward with their
velocity to now; without that those of a moving formation seem to lag and pull. `obstacle_band` is
an addition, 0 as in the papers: the proxy is repelled where it is nearer than that to an obstacle's
radius. For obstacles that stand still the proofs go through with it, a leader that moves spoils
them. The spring's bound belongs to an axis, own.max_force to the norm of the whole force, which is
cut at it last; a limit below own.max_force/sqrt(d) less mass times disturbance is never cut.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from controllers.bounded_potential import BoundedPotential, bounded_potential
from controllers.graph import Formation, FormationParams, distance, formation, remember
from testbed.core.compiled import compiled
from testbed.core.law import Body, compiled_broadcast, compiled_jump
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
    """The same with the formation, for compiled code."""

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
    """Parameters as the compiled code wants them."""
    if 0.0 < params.obstacle_band <= shape.near_margin:
        raise ValueError(
            f"obstacle_band: expected 0 or more than near_margin = {shape.near_margin:g} m, "
            f"found {params.obstacle_band:g} m"
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
    """The proxy begins at rest where the satellite is, Eq. (10) of 2022, with the edges of E(0)."""
    return np.concatenate((own.p, np.zeros_like(own.p), c.formation.first[own.vehicle_index]))


@compiled
def saturated(x, limit):
    """Each axis between -limit and limit."""
    return np.minimum(np.maximum(x, -limit), limit)


@compiled
def soft_sign(x, layer):
    """Of each axis: sgn, or linear inside a boundary layer."""
    return np.sign(x) if layer == 0.0 else np.minimum(np.maximum(x / layer, -1.0), 1.0)


@compiled
def is_edge(law_state, d, j):
    """Whether a_ij = 1; j < 0 is somebody who does not belong to the formation."""
    return j >= 0 and law_state[2 * d + j] > 0.5


@compiled
def heard_proxy(neighbours, k, t, d):
    """Position and velocity of the k-th neighbour's proxy now, shape (2, d).

    Where its law told nothing, the neighbour itself stands for its proxy.
    """
    q = np.empty((2, d))
    told = neighbours.message.shape[1] >= 2 * d
    late = t - neighbours.message_t[k]
    for i in range(d):
        if told:
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
        return  # no direction to prefer
    slope = bounded_potential(potential, x, desired)[1]
    for i in range(here.shape[0]):
        total[i] -= weight * slope * (here[i] - there[i]) / x


@compiled
def potential_force(c, law_state, own, neighbours, world, t):
    """- sum_j a_ij grad_i P psi on the proxy, and obstacles, shape (d,) [N]."""
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
    """Edges, from real positions."""
    return remember(gains.coupling.formation, law_state, 2 * own.p.shape[0], own, neighbours, world)


def _broadcast(gains, law_state, own, neighbours, world, t):
    """Where the proxy is and how fast."""
    return law_state[: 2 * own.p.shape[0]].copy()


def with_proxy(gains_type: type) -> tuple[Callable, Callable]:
    """Jump and tell of a law whose gains have a `coupling`: what all laws with a proxy do."""
    return compiled_jump(gains_type)(_jump), compiled_broadcast(gains_type)(_broadcast)
