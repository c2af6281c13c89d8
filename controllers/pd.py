"""Proportional-derivative control to a goal without obstacle avoidance.

Source: any textbook, for instance K. J. Astrom, R. M. Murray, "Feedback Systems", 2nd ed., 2021,
chapter 11. It is the baseline for laws with collision avoidance.

    force = m (w^2 (p_goal - p) + 2 z w (v_goal - v) + a_goal - disturbance)

    textbook     code         meaning                              unit
    omega_0      bandwidth    undamped natural frequency w         rad/s
    zeta         damping      z                                    -

The estimated disturbance, own.disturbance, replaces the integral term. The force is limited to
own.max_force, direction kept.
"""

from typing import NamedTuple

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from controllers.scale import Scale
from testbed.core.law import CompiledLaw, Law, no_state, shorten
from testbed.core.law_verbs import compiled_rate
from testbed.core.vehicle import Positive

Array = NDArray[np.float64]


class PdParams(Struct, frozen=True, forbid_unknown_fields=True, tag="pd"):
    """Parameters of the closed loop as a damped oscillator."""

    bandwidth: Positive = 0.1  # [rad/s]
    damping: Positive = 1.0
    scale: Scale = field(default_factory=Scale)


class Gains(NamedTuple):
    """Parameters for compiled code."""

    stiffness: float  # [1/s^2]
    damping: float  # [1/s]


@compiled_rate(Gains)
def rate(gains, law_state, own, neighbours, world, t, force, change):
    """Write the force, see `testbed.core.law`; the law has no state."""
    for i in range(force.shape[0]):
        force[i] = own.mass * (
            gains.stiffness * (world.goal.p[i] - own.p[i])
            + gains.damping * (world.goal.v[i] - own.v[i])
            + world.goal.a[i]
            - own.disturbance[i]
        )
    shorten(force, own.max_force)


def pd(params: PdParams) -> Law:
    """The law for positions of any shape (d,)."""
    w, z = params.bandwidth, params.damping
    return CompiledLaw(Gains(w * w, 2.0 * z * w), no_state, rate)
