r"""Following a leader of constant velocity with bounded forces.

Source: X. Xue, X. Wang, N. Han, "Leader-following connectivity preservation and collision avoidance
control for multiple spacecraft with bounded actuation", Aerospace 11:612, 2024. Equation numbers
are that paper's. `proxy` lists the symbols common to all proxy laws.

    paper            code                   meaning                                       unit
    p_0, p_0'        world.goal.p, .v       leader                                        m, m/s
    alpha            alpha                  friction between proxies                      N s/m
    beta             beta                   damping of satellites that hear the leader    N s/m
    s_i              s                      velocity relative to the leader               m/s
    a_i0             the last edge          1 if satellite i hears the leader             -
    m g + m C p'     own.mass * own.disturbance   the caller must include the Coriolis term     N

Corrections to the print: (4) lost the dots of p_i hat'', (5) those of both velocities; the
derivative of V requires them.

A satellite that does not hear the leader does not read the goal. The option `feed_forward`, an
addition, is the only exception: it adds m p_0'' to the force and the proxy's mass times p_0'' to
the proxy, so that the proof holds for a leader that accelerates. Every satellite must then know
the leader's plan. Prefer it to the sgn law for time-varying velocity, whose formation locks.

beta damps only satellites that hear the leader; with the paper's gains the slowest mode of the
others takes hundreds of seconds.
"""

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import numpy as np
from msgspec import Struct, field

from controllers.graph import FormationKind, FormationParams
from controllers.proxy import (
    Coupling,
    ProxyParams,
    coupling,
    heard_proxy,
    is_edge,
    potential_force,
    saturated,
    start,
    with_proxy,
)
from controllers.scale import Scale
from testbed.core.compiled import compiled
from testbed.core.law import CompiledLaw, Law, bounded
from testbed.core.law_verbs import compiled_rate
from testbed.core.vehicle import NonNegative, Positive


class BoundedLeaderParams(Struct, frozen=True, forbid_unknown_fields=True, tag="bounded_leader"):
    """Section 4.1, in the paper's units."""

    forms: ClassVar[FormationKind] = "led graph"
    formation: FormationParams
    proxy: ProxyParams
    alpha: Positive  # [N s/m]
    beta: NonNegative  # [N s/m]
    feed_forward: bool = False  # of the leader's acceleration, to every satellite
    scale: Scale = field(default_factory=Scale)


class Gains(NamedTuple):
    """Parameters for compiled code."""

    coupling: Coupling
    alpha: float
    beta: float
    forward: float  # 1.0 with feed-forward, else 0.0


@compiled
def friction(law_state, own, neighbours, world, t):
    """- u_i hat / alpha, Eq. (5), shape (d,) [m/s]."""
    d, leader = own.p.shape[0], law_state.shape[0] - 2 * own.p.shape[0] - 1
    total = np.zeros(d)
    for k in range(neighbours.p.shape[0]):
        if is_edge(law_state, d, neighbours.vehicle_index[k]):
            total += law_state[d : 2 * d] - heard_proxy(neighbours, k, t, d)[1]
    if is_edge(law_state, d, leader):
        total += law_state[d : 2 * d] - world.goal.v
    return total


@compiled_rate(Gains)
def rate(gains, law_state, own, neighbours, world, t):
    """Force and rate of the proxy's state, see `testbed.core.law`."""
    d, leader = own.p.shape[0], law_state.shape[0] - 2 * own.p.shape[0] - 1
    c = gains.coupling
    stretch = own.p - law_state[:d]
    push = potential_force(c, law_state, own, neighbours, world, t)
    drag = gains.alpha * friction(law_state, own, neighbours, world, t)  # Eq. (5)
    ahead = gains.forward * world.goal.a if gains.forward > 0.0 else np.zeros(d)
    change = np.zeros(law_state.shape[0])
    change[:d] = law_state[d : 2 * d]
    change[d : 2 * d] = (
        ahead + (saturated(c.spring * stretch, c.limit) + push - drag) / c.mass
    )  # (4)
    pull = c.spring * stretch
    if is_edge(law_state, d, leader):
        pull += gains.beta * (own.v - world.goal.v)
    force = -saturated(pull, c.limit) + own.mass * (ahead - own.disturbance)  # Eq. (14)
    return bounded(force, own.max_force), change


jump, broadcast = with_proxy(Gains)


def bounded_leader(params: BoundedLeaderParams, names: Sequence[str], d: int) -> Law:
    """The law for positions of shape (d,), in the paper's units.

    `names` are those of all satellites in the order of `Body.vehicle_index`.
    """
    c = coupling(params.proxy, params.formation, names, led=True)
    gains = Gains(c, params.alpha, params.beta, float(params.feed_forward))
    return CompiledLaw(gains, lambda own: start(c, own), rate, message_size=2 * d)
