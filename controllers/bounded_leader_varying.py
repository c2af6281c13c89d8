r"""Following a leader of time-varying velocity and unknown acceleration with bounded forces.

Source: X. Xue, X. Wang, N. Han, "Leader-following connectivity preservation and collision avoidance
control for multiple spacecraft with bounded actuation", Aerospace 11:612, 2024. Equation numbers
are that paper's. `proxy` lists the symbols common to all proxy laws.

    paper            code                   meaning                                       unit
    p_0, p_0'        world.goal.p, .v       leader                                        m, m/s
    alpha            alpha                  gain of sgn between proxies                   N
    beta             beta                   gain of sgn between satellites                N
    -                layer                  boundary layer of sgn; 0: true sgn            m/s
    a_i0             the last edge          1 if satellite i hears the leader             -
    m g + m C p'     own.mass * own.disturbance   the caller must include the Coriolis term     N

Corrections to the print: (25) lost the dots of p_i hat'', (26) those of both velocities. Theorem 2
needs alpha > mass gamma/sqrt(lambda_min), beta > max(m) gamma/sqrt(lambda_min) with the largest
satellite's mass, gamma >= sqrt(N) |p_0''|; "beta = alpha/m_i" contradicts the paper's own numbers.

Theorem 2 (3), that the distances converge, is wrong. The sgn of a relative velocity is Coulomb
friction: where the potential's forces are smaller than it, satellites with equal velocities keep
their distances. The other claims hold: velocities follow the leader, edges are kept, satellites do
not collide. A boundary layer lets the formation creep towards its shape and leaves a velocity error
of about its width.
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
    soft_sign,
    start,
    with_proxy,
)
from controllers.scale import Scale
from testbed.core.law import CompiledLaw, Law, bounded
from testbed.core.law_verbs import compiled_rate
from testbed.core.vehicle import NonNegative, Positive


class BoundedLeaderVaryingParams(
    Struct, frozen=True, forbid_unknown_fields=True, tag="bounded_leader_varying"
):
    """Section 4.2, in the paper's units."""

    forms: ClassVar[FormationKind] = "led graph"
    formation: FormationParams
    proxy: ProxyParams
    alpha: Positive  # [N]
    beta: Positive  # [N]
    layer: NonNegative = 0.0  # [m/s]
    scale: Scale = field(default_factory=Scale)


class Gains(NamedTuple):
    """Parameters for compiled code."""

    coupling: Coupling
    alpha: float
    beta: float
    layer: float


@compiled_rate(Gains)
def rate(gains, law_state, own, neighbours, world, t):
    """Force and rate of the proxy's state, see `testbed.core.law`."""
    d, leader = own.p.shape[0], law_state.shape[0] - 2 * own.p.shape[0] - 1
    c, speed = gains.coupling, law_state[d : 2 * d]
    between_proxies, between_satellites = np.zeros(d), np.zeros(d)
    for k in range(neighbours.p.shape[0]):
        if is_edge(law_state, d, neighbours.vehicle_index[k]):
            other = heard_proxy(neighbours, k, t, d)[1]
            between_proxies += soft_sign(speed - other, gains.layer)
            between_satellites += soft_sign(own.v - neighbours.v[k], gains.layer)
    if is_edge(law_state, d, leader):
        between_proxies += soft_sign(speed - world.goal.v, gains.layer)
        between_satellites += soft_sign(own.v - world.goal.v, gains.layer)
    spring = saturated(c.spring * (own.p - law_state[:d]), c.limit)
    push = potential_force(c, law_state, own, neighbours, world, t)
    change = np.zeros(law_state.shape[0])
    change[:d] = speed
    change[d : 2 * d] = (spring + push - gains.alpha * between_proxies) / c.mass  # Eqs. (25), (26)
    force = (
        -spring - own.mass * own.disturbance - gains.beta * between_satellites
    )  # Eqs. (27), (28)
    return bounded(force, own.max_force), change


jump, broadcast = with_proxy(Gains)


def bounded_leader_varying(params: BoundedLeaderVaryingParams, names: Sequence[str], d: int) -> Law:
    """The law for positions of shape (d,), in the paper's units.

    `names` are those of all satellites in the order of `Body.vehicle_index`.
    """
    c = coupling(params.proxy, params.formation, names, led=True)
    gains = Gains(c, params.alpha, params.beta, params.layer)
    return CompiledLaw(gains, lambda own: start(c, own), rate, message_size=2 * d)
