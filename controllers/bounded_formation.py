r"""Formation keeping with bounded forces, without a leader.

Source: X. Xue, X. Yue, J. Yuan, "Connectivity preservation and collision avoidance control for
spacecraft formation flying with bounded actuation", Advances in Guidance, Navigation and Control
(ICGNC 2020), Springer 2022, pp. 3685-3697. Equation numbers are that paper's. `proxy` lists the
symbols common to all proxy laws.

    paper       code             meaning                                                  unit
    beta_i      beta             friction of the proxy                                    N s/m
    alpha_i     proxy.spring     stiffness between satellite and proxy                    N/m

Differences from the paper: m g is own.mass * own.disturbance. In orbit the caller may include the
Coriolis term or not: it does no work, so the paper's proof holds either way. On the table it is the
estimated disturbance.

The law does not fix the formation in place: a common disturbance makes it drift.
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
    potential_force,
    saturated,
    start,
    with_proxy,
)
from controllers.scale import Scale
from testbed.core.law import CompiledLaw, Law, bounded
from testbed.core.law_verbs import compiled_rate
from testbed.core.vehicle import Positive


class BoundedFormationParams(
    Struct, frozen=True, forbid_unknown_fields=True, tag="bounded_formation"
):
    """Section 4, in the paper's units."""

    forms: ClassVar[FormationKind] = "graph"
    formation: FormationParams
    proxy: ProxyParams
    beta: Positive  # [N s/m]
    scale: Scale = field(default_factory=Scale)


class Gains(NamedTuple):
    """Parameters for compiled code."""

    coupling: Coupling
    beta: float


@compiled_rate(Gains)
def rate(gains, law_state, own, neighbours, world, t):
    """Force and rate of the proxy's state, see `testbed.core.law`."""
    d = own.p.shape[0]
    c = gains.coupling
    spring = saturated(c.spring * (own.p - law_state[:d]), c.limit)
    push = potential_force(c, law_state, own, neighbours, world, t)
    change = np.zeros(law_state.shape[0])
    for i in range(d):
        speed = law_state[d + i]
        change[i] = speed
        change[d + i] = (spring[i] + push[i] - gains.beta * speed) / c.mass  # Eq. (9)
    force = -spring - own.mass * own.disturbance  # Eq. (14)
    return bounded(force, own.max_force), change


jump, broadcast = with_proxy(Gains)


def bounded_formation(params: BoundedFormationParams, names: Sequence[str], d: int) -> Law:
    """The law for positions of shape (d,), in the paper's units.

    `names` are those of all satellites in the order of `Body.vehicle_index`.
    """
    c = coupling(params.proxy, params.formation, names, led=False)
    return CompiledLaw(Gains(c, params.beta), lambda own: start(c, own), rate, message_size=2 * d)
