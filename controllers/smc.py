r"""First-order sliding mode control with obstacle avoidance: the baseline of zhang2023.

Source: J. Zhang, Y. Wang, J. Jia, C. Chi, H. Li, "Collision avoidance second order sliding mode
control of satellite formation with air-floated platform semi-physical simulation",
Electronics 12:3179, 2023. Equation numbers are that paper's.

    paper               code             meaning                                   unit
    s                   s                sliding surface k nabla U + e_dot         m/s
    k                   surface          gain of the surface, Table 4              1/s
    lambda_1, lambda_2  linear, root     gains of the reaching law                 1/s, -
    alpha               alpha            exponent of the reaching law              -
    f                   own.disturbance  acceleration without control              m/s^2

Corrections to the print: the last term of Eq. (44), r_d, is the acceleration of the goal.

Differences from the paper: the force is limited to own.max_force, direction kept.
"""

from typing import NamedTuple

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from controllers.potential import (
    Diagonal,
    Potential,
    PotentialParams,
    diagonal,
    gradient,
    potential,
)
from controllers.scale import Scale
from testbed.core.law import CompiledLaw, Law, no_state, shorten
from testbed.core.law_verbs import compiled_rate
from testbed.core.scratch import scratch
from testbed.core.vehicle import NonNegative

Array = NDArray[np.float64]


class SmcParams(Struct, frozen=True, forbid_unknown_fields=True, tag="smc"):
    """Table 4, in the paper's units."""

    k: Diagonal = (0.5, 0.3, 0.4)  # [1/s]
    lambda_1: Diagonal = 0.3  # [1/s]
    lambda_2: Diagonal = 0.3
    alpha: NonNegative = 0.5
    potential: PotentialParams = field(default_factory=PotentialParams)
    scale: Scale = field(default_factory=Scale)


class Gains(NamedTuple):
    """Parameters for compiled code; arrays of shape (d,)."""

    surface: Array
    linear: Array
    root: Array
    alpha: float
    potential: Potential


@compiled_rate(Gains)
def rate(gains, law_state, own, neighbours, world, t, force, change):
    """Write the force, see `testbed.core.law`; the law has no state."""
    d = own.p.shape[0]
    # Omega depends on velocities only, so the force, not known yet, does not affect it
    force[:] = 0.0
    e, g = scratch((3, d)), scratch((3, d))
    gradient(gains.potential, own, force, neighbours, world, e, g)
    for i in range(d):
        s = gains.surface[i] * g[0, i] + e[1, i]  # Eq. (15)
        force[i] = own.mass * (  # Eq. (44)
            -gains.surface[i] * g[1, i]
            - gains.linear[i] * s
            - gains.root[i] * np.sign(s) * abs(s) ** gains.alpha
            - own.disturbance[i]
            + world.goal.a[i]
        )
    shorten(force, own.max_force)


def smc(params: SmcParams, d: int) -> Law:
    """The law for positions of shape (d,), in the paper's units."""
    gains = Gains(
        diagonal(params.k, d),
        diagonal(params.lambda_1, d),
        diagonal(params.lambda_2, d),
        params.alpha,
        potential(params.potential, d),
    )
    return CompiledLaw(gains, no_state, rate)
