r"""Sliding mode control with collision avoidance, without connectivity: the baseline of xue2021.

Source: Q. Hu, H. Dong, Y. Zhang, G. Ma, "Tracking control of spacecraft formation flying with
collision avoidance", Aerosp. Sci. Technol. 42, 2015, as X. Xue, X. Yue, J. Yuan, Adv. Space Res.
67:3504, 2021, write it. Equation numbers are those of 2021.

    paper        code             meaning                                                  unit
    s_i          s                p' + tau grad J                                          m/s
    tau          tau              velocity per force                                       m/(s N)
    gamma        gamma            gain of sgn of s                                         N
    -            layer            boundary layer of sgn; 0: true sgn                       m/s
    K_d          k_d              friction of s                                            N s/m
    K_F, K_O     potential        weights of J, each pair counted once                     N
    m_i hat      law_state[0]     estimated mass                                           kg
    F_i          own.disturbance  C p' + g, as on the right-hand side of (1)               m/s^2

Corrections to the print: m hat F cancels F only if F is on the right-hand side of (1).

The paper does not print J_ij. Here it is psi^r of 2021 below the desired distance; above it
`attract` selects psi^d ("cosine": ends at the range, because the baseline does not keep
connectivity), psi^a ("log") or psi^r continued with the gain of psi^a ("continued": a well without
a range). Every neighbour that is heard counts, at any distance: in Hu et al. every satellite knows
all others.
"""

from collections.abc import Sequence
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from msgspec import Struct, field

from controllers.formation_potential import (
    FormationPotential,
    FormationPotentialParams,
    add_gradient,
    formation_potential,
    obstacle_gradient,
)
from controllers.graph import FormationKind, FormationParams, distance
from controllers.log_potential import log_potential
from controllers.proxy import soft_sign
from controllers.scale import Scale
from testbed.core.compiled import compiled
from testbed.core.law import CompiledLaw, Law, bounded
from testbed.core.law_verbs import compiled_rate
from testbed.core.vehicle import NonNegative, Positive


class CollisionSlidingParams(
    Struct, frozen=True, forbid_unknown_fields=True, tag="collision_sliding"
):
    """Section 4, first case, in the paper's units."""

    forms: ClassVar[FormationKind] = "graph"
    formation: FormationParams
    potential: FormationPotentialParams = field(
        default_factory=lambda: FormationPotentialParams(k_f=40.0, k_o=40.0, pair_count=1)
    )
    attract: Literal["cosine", "log", "continued"] = "cosine"
    gamma: NonNegative = 0.2  # [N]
    k_d: NonNegative = 0.1  # [N s/m]
    tau: Positive = 0.1  # [m/(s N)]
    layer: NonNegative = 0.0  # [m/s]
    alpha: NonNegative = 0.5  # [kg s^2/m^2]
    mass: Positive | None = None  # m hat at the start; null: the nominal one [kg]
    scale: Scale = field(default_factory=Scale)


class Gains(NamedTuple):
    """Parameters for compiled code."""

    potential: FormationPotential
    held: bool  # psi^a for every pair
    continued: bool  # psi^r also beyond d, with the gain of psi^a
    gamma: float
    k_d: float
    tau: float
    layer: float
    alpha: float


@compiled
def gradient(gains, own, neighbours, world):
    """Gradient of J, Eq. (32), shape (d,) [N]."""
    u, total = gains.potential, np.zeros(own.p.shape[0])
    for k in range(neighbours.p.shape[0]):
        if neighbours.vehicle_index[k] < 0:
            continue
        x = distance(own.p, neighbours.p[k])
        d = u.formation.desired[own.vehicle_index, neighbours.vehicle_index[k]]
        if gains.continued and x > d:
            slope = u.single.attract * (x - d) / (x - u.single.safe)  # Eq. (30)
        else:
            slope = log_potential(u.single, x, d, gains.held)[1]
        add_gradient(u.pairs * slope, own.p, neighbours.p[k], x, total)
    for k in range(world.obstacles.p.shape[0]):
        total += obstacle_gradient(u, own, world.obstacles, k)
    return total


@compiled_rate(Gains)
def rate(gains, law_state, own, neighbours, world, t):
    """Force and change of the estimated mass, see `testbed.core.law`."""
    s = own.v + gains.tau * gradient(gains, own, neighbours, world)  # Eq. (32)
    force = (
        -gains.gamma * soft_sign(s, gains.layer) - gains.k_d * s - law_state[0] * own.disturbance
    )
    change = np.zeros(1)
    change[0] = gains.alpha * np.sum(s * own.disturbance)
    return bounded(force, own.max_force), change  # Eq. (31)


def collision_sliding(params: CollisionSlidingParams, names: Sequence[str], d: int) -> Law:
    """The law for positions of shape (d,), in the paper's units.

    `names` are those of all satellites in the order of `Body.vehicle_index`.
    """
    u = formation_potential(params.potential, params.formation, names)
    widest = float(u.formation.desired.max())
    if params.attract == "log" and widest >= params.formation.far:
        raise ValueError(
            f'attract = "log" keeps every pair within {params.formation.far:g} m, found a desired '
            f'distance of {widest:g} m: choose "cosine"'
        )
    gains = Gains(
        u,
        params.attract == "log",
        params.attract == "continued",
        params.gamma,
        params.k_d,
        params.tau,
        params.layer,
        params.alpha,
    )
    return CompiledLaw(gains, lambda own: np.array([params.mass or own.mass]), rate)
