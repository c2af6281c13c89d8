"""Proportional-derivative control to a goal, blind to obstacles: what everybody tries first.

Source: any textbook, for instance K. J. Astrom, R. M. Murray, "Feedback Systems", 2nd ed., 2021,
chapter 11. It is here as the baseline that shows what avoidance avoids.

    force = m (w^2 (p_goal - p) + 2 z w (v_goal - v) + a_goal - disturbance)

    textbook     code         meaning                              unit
    omega_0      bandwidth    undamped natural frequency w         rad/s
    zeta         damping      z                                    -

The disturbance that the estimator sees, own.disturbance, takes the place of the integral term. The
force is bounded by own.max_force, direction kept.
"""

from typing import NamedTuple

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from controllers.scale import Scale
from testbed.core.law import CompiledLaw, Law, bounded, compiled_rate, no_state
from testbed.core.vehicle import Positive

Array = NDArray[np.float64]


class PdParams(Struct, frozen=True, forbid_unknown_fields=True, tag="pd"):
    """Gains."""

    bandwidth: Positive = 0.1  # [rad/s]
    damping: Positive = 1.0
    scale: Scale = field(default_factory=Scale)


class Gains(NamedTuple):
    """The same, for compiled code."""

    stiffness: float  # [1/s^2]
    damping: float  # [1/s]


@compiled_rate(Gains)
def rate(gains, law_state, own, neighbours, world, t):
    """Force, see `testbed.core.law`; the law has no state."""
    d = own.p.shape[0]
    force = np.empty(d)
    for i in range(d):
        force[i] = own.mass * (
            gains.stiffness * (world.goal.p[i] - own.p[i])
            + gains.damping * (world.goal.v[i] - own.v[i])
            + world.goal.a[i]
            - own.disturbance[i]
        )
    return bounded(force, own.max_force), np.empty(0)


def pd(params: PdParams) -> Law:
    """The law for positions of any shape (d,)."""
    w, z = params.bandwidth, params.damping
    return CompiledLaw(Gains(w * w, 2.0 * z * w), no_state, rate)
