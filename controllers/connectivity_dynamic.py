r"""Formation keeping among obstacles that move, mass unknown.

Source: X. Xue, X. Yue, J. Yuan, "Connectivity preservation and collision avoidance control for
spacecraft formation flying in the presence of multiple obstacles", Adv. Space Res. 67:3504, 2021.
Equation numbers are that paper's.

    paper        code             meaning                                                  unit
    s_i          s                velocity minus v hat; broadcast to the others            m/s
    v_i hat      velocity         velocity the potential asks for, Eq. (16)                m/s
    w_ik         swerve           part of an obstacle's velocity, Eq. (17)                 m/s
    nu           nu               keeps (17) finite, Remark 4                              N
    1            kappa            velocity per force in (16)                               m/(s N)
    K_c, K_s     k_c, k_s         friction between neighbours, and of s                    N s/m
    beta_i       beta             gain of sgn of s                                         N
    -            layer            boundary layer of sgn; 0: true sgn                       m/s
    m_i hat      law_state[0]     estimated mass                                           kg
    a_ij         law_state[1:]    edges, see `graph`                                       -
    Y_i          -own.disturbance minus the acceleration without control, Eq. (8)          m/s^2

Corrections to the print: the sum in (21) starts at j = 1, because there is no leader; the list of
gains prints K_v for K_s. (16) sets a velocity equal to a force: kappa is the implied factor of
1 m/(s N), which must be scaled with the problem.

Differences from the paper: w is singular where a component of the gradient of Psi crosses zero and
then asks for hundreds of newtons. `swerve` selects a version: "paper" is (17) with a zero
denominator replaced by nu, "smooth" is g v_o G/(G^2 + nu^2), "off" omits w. The filter (18) is
omitted: only the bound in the proof needs it. Small thrusters cannot meet the condition
beta > gamma and the force is limited to own.max_force, so the proof does not cover a flight of this
law.
"""

from collections.abc import Sequence
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from msgspec import Struct, field

from controllers.formation_potential import (
    FormationPotential,
    FormationPotentialParams,
    disagreement,
    formation_potential,
    gradient,
    obstacle_gradient,
    with_edges,
)
from controllers.graph import FormationKind, FormationParams
from controllers.proxy import soft_sign
from controllers.scale import Scale
from testbed.core.compiled import compiled
from testbed.core.law import CompiledLaw, Law, bounded
from testbed.core.law_verbs import compiled_broadcast, compiled_rate
from testbed.core.vehicle import NonNegative, Positive

OFF, SMOOTH, PAPER = 0, 1, 2


class ConnectivityDynamicParams(
    Struct, frozen=True, forbid_unknown_fields=True, tag="connectivity_dynamic"
):
    """Section 4, second case, in the paper's units; K_s is not printed and so has no default."""

    forms: ClassVar[FormationKind] = "graph"
    formation: FormationParams
    k_s: Positive  # [N s/m]
    potential: FormationPotentialParams = field(
        default_factory=lambda: FormationPotentialParams(k_f=50.0, k_o=50.0, k_d=0.05)
    )
    k_c: NonNegative = 0.1  # [N s/m]
    beta: NonNegative = 0.01  # [N]
    layer: NonNegative = 0.0  # [m/s]
    kappa: Positive = 1.0  # [m/(s N)]
    swerve: Literal["off", "smooth", "paper"] = "smooth"
    nu: Positive = 0.1  # [N]
    alpha: NonNegative = 0.01  # [kg s^2/m^2]
    mass: Positive | None = None  # m hat at the start; null: the nominal one [kg]
    scale: Scale = field(default_factory=Scale)


class Gains(NamedTuple):
    """Parameters for compiled code."""

    potential: FormationPotential
    k_c: float
    k_s: float
    beta: float
    layer: float
    kappa: float
    swerve: int
    nu: float
    alpha: float


@compiled
def swerved(gains, own, obstacles, gradient):
    """K_o sum of w_ik, Eq. (17), shape (d,) [m/s]; `gradient` is that of Psi."""
    total = np.zeros(own.p.shape[0])
    if gains.swerve == OFF:
        return total
    for k in range(obstacles.p.shape[0]):
        share = obstacle_gradient(gains.potential, own, obstacles, k)  # K_o included
        for q in range(own.p.shape[0]):
            g, power = gradient[q], share[q] * obstacles.v[k, q]
            if share[q] == 0.0:
                continue
            if gains.swerve == SMOOTH:
                total[q] += power * g / (g * g + gains.nu**2)
            else:
                total[q] += power / (g if g != 0.0 else gains.nu)
    return total


@compiled
def sliding(gains, law_state, own, neighbours, world):
    """s, Eq. (15), and the gradient of Psi, rows of (2, d) [m/s, N]."""
    both = np.empty((2, own.p.shape[0]))
    both[1] = gradient(gains.potential, law_state, 1, own, neighbours, world)
    velocity = -gains.kappa * both[1] + swerved(gains, own, world.obstacles, both[1])  # Eq. (16)
    both[0] = own.v - velocity
    return both


@compiled_rate(Gains)
def rate(gains, law_state, own, neighbours, world, t):
    """Force and change of the estimated mass, see `testbed.core.law`."""
    both = sliding(gains, law_state, own, neighbours, world)
    s = both[0]
    force = -gains.k_s * s - gains.beta * soft_sign(s, gains.layer) - both[1]
    force -= law_state[0] * own.disturbance
    others = disagreement(law_state, 1, s, neighbours.vehicle_index, neighbours.message)
    force -= gains.k_c * others  # Eq. (21)
    change = np.zeros(law_state.shape[0])
    change[0] = gains.alpha * np.sum(s * own.disturbance)  # Eq. (22)
    return bounded(force, own.max_force), change


jump = with_edges(Gains)


@compiled_broadcast(Gains)
def broadcast(gains, law_state, own, neighbours, world, t):
    """s, Eq. (15), which the law broadcasts to the others."""
    return sliding(gains, law_state, own, neighbours, world)[0].copy()


def connectivity_dynamic(params: ConnectivityDynamicParams, names: Sequence[str], d: int) -> Law:
    """The law for positions of shape (d,), in the paper's units.

    `names` are those of all satellites in the order of `Body.vehicle_index`.
    """
    u = formation_potential(params.potential, params.formation, names)
    gains = Gains(
        u,
        params.k_c,
        params.k_s,
        params.beta,
        params.layer,
        params.kappa,
        {"off": OFF, "smooth": SMOOTH, "paper": PAPER}[params.swerve],
        params.nu,
        params.alpha,
    )
    return CompiledLaw(
        gains,
        lambda own: np.concatenate(
            ([params.mass or own.mass], u.formation.first[own.vehicle_index])
        ),
        rate,
        message_size=d,
    )
