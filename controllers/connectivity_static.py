r"""Formation keeping among obstacles that stand still, mass unknown.

Source: X. Xue, X. Yue, J. Yuan, "Connectivity preservation and collision avoidance control for
spacecraft formation flying in the presence of multiple obstacles", Adv. Space Res. 67:3504, 2021.
Equation numbers are that paper's.

    paper        code             meaning                                                  unit
    K_c, K_v     k_c, k_v         friction between neighbours, and against the frame       N s/m
    m_i hat      law_state[0]     estimated mass                                           kg
    a_ij         law_state[1:]    edges, see `graph`                                       -
    Y_i          -own.disturbance minus the acceleration without control, Eq. (8)          m/s^2
    alpha        alpha            adaptation gain                                     kg s^2/m^2

Corrections to the print: (7) lost the dot of m_i hat'.

Differences from the paper: the force is limited to own.max_force, direction kept. The proof does
not cover this; the theorem applies to a flight that never reaches the limit. On a level table
own.disturbance is the estimated disturbance or zero, so the mass estimate hardly changes.
"""

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import numpy as np
from msgspec import Struct, field

from controllers.formation_potential import (
    FormationPotential,
    FormationPotentialParams,
    disagreement,
    formation_potential,
    gradient,
    with_edges,
)
from controllers.graph import FormationKind, FormationParams
from controllers.scale import Scale
from testbed.core.law import CompiledLaw, Law, bounded
from testbed.core.law_verbs import compiled_rate
from testbed.core.vehicle import NonNegative, Positive


class ConnectivityStaticParams(
    Struct, frozen=True, forbid_unknown_fields=True, tag="connectivity_static"
):
    """Section 4, first case, in the paper's units."""

    forms: ClassVar[FormationKind] = "graph"
    formation: FormationParams
    potential: FormationPotentialParams = field(default_factory=FormationPotentialParams)
    k_c: NonNegative = 0.1  # [N s/m]
    k_v: Positive = 0.1  # [N s/m]
    alpha: NonNegative = 0.01  # [kg s^2/m^2]
    mass: Positive | None = None  # m hat at the start; null: the nominal one [kg]
    scale: Scale = field(default_factory=Scale)


class Gains(NamedTuple):
    """Parameters for compiled code."""

    potential: FormationPotential
    k_c: float
    k_v: float
    alpha: float


@compiled_rate(Gains)
def rate(gains, law_state, own, neighbours, world, t):
    """Force and change of the estimated mass, see `testbed.core.law`."""
    force = -gradient(gains.potential, law_state, 1, own, neighbours, world) - gains.k_v * own.v
    force -= law_state[0] * own.disturbance
    others = disagreement(law_state, 1, own.v, neighbours.vehicle_index, neighbours.v)
    force -= gains.k_c * others  # Eq. (6)
    change = np.zeros(law_state.shape[0])
    change[0] = gains.alpha * np.sum(own.v * own.disturbance)  # Eq. (7)
    return bounded(force, own.max_force), change


jump = with_edges(Gains)


def connectivity_static(params: ConnectivityStaticParams, names: Sequence[str], d: int) -> Law:
    """The law for positions of shape (d,), in the paper's units.

    `names` are those of all satellites in the order of `Body.vehicle_index`.
    """
    u = formation_potential(params.potential, params.formation, names)
    return CompiledLaw(
        Gains(u, params.k_c, params.k_v, params.alpha),
        lambda own: np.concatenate(
            ([params.mass or own.mass], u.formation.first[own.vehicle_index])
        ),
        rate,
    )
