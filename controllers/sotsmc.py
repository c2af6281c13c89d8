r"""Second-order terminal sliding mode control with obstacle avoidance (SOTSMC).

Source: J. Zhang, Y. Wang, J. Jia, C. Chi, H. Li, "Collision avoidance second order sliding mode
control of satellite formation with air-floated platform semi-physical simulation",
Electronics 12:3179, 2023. Equation numbers are that paper's.

    paper           code                meaning                                    unit
    rho, rho_d      own.p, goal.p       position, desired position                 m
    u               u = law_state[:d]   control, an integral                       N
    d_m hat         law_state[d]        adapted bound of the disturbance's rate    m/s^3
    e               e[0]                position error; e[1], e[2]: its rates      m
    nabla U, Omega  g[0], g[1]          gradient of the potential, its rate        m, m/s
    s, sigma        s, sigma            sliding surface, switching function        m/s
    lambda          surface             gain of the surface                        1/s
    k               reach               gain of sigma                              1/s^2
    beta, p/q       beta, power         terminal sliding mode                      -
    epsilon, eta    margin, adapt       switching margin, adaptation gain          m/s^3, -
    M0              own.mass            nominal mass                               kg
    -C0 v - G0      own.disturbance     acceleration without control               m/s^2

Corrections to the print, with which nothing moves: (15) prints k for the surface's gain while
Table 3 lists both lambda = 1 and k = 1e-3; lambda belongs in (15), k in front of sigma in (28). The
last nominal term of (28) is s_dot^(2 - p/q), as follows from (25).

Differences from the paper: the force is limited to own.max_force. The integral u is limited to the
same bound: `bound_change` limits its rate and pulls it back from beyond the bound, because an
integral beyond the thrust limit winds up (the paper's closing remark). s_dot uses the limited force
and own.disturbance, which on the table is the estimated disturbance.
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
from testbed.core.compiled import inlined
from testbed.core.error import MismatchError
from testbed.core.law import Body, CompiledLaw, Law, shorten
from testbed.core.law_verbs import compiled_rate
from testbed.core.scratch import scratch
from testbed.core.vehicle import NonNegative, Positive

Array = NDArray[np.float64]

PULL = 10.0  # rate at which u returns to the bound from beyond it [1/s]
SLEW = 100.0  # limit of the rate of u over max_force, in the paper's seconds [1/s]


class SotsmcParams(Struct, frozen=True, forbid_unknown_fields=True, tag="sotsmc"):
    """Table 3, in the paper's units."""

    surface: Diagonal = field(default=1.0, name="lambda")  # [1/s]
    k: Diagonal = 1e-3  # [1/s^2]
    beta: Diagonal = 1.0
    p: Positive = 5.0
    q: Positive = 3.0  # 1 < p/q < 2
    epsilon: NonNegative = 0.1  # [m/s^3]
    eta: NonNegative = 1e-5
    potential: PotentialParams = field(default_factory=PotentialParams)
    scale: Scale = field(default_factory=Scale)

    def __post_init__(self) -> None:
        if not 1.0 < self.p / self.q < 2.0:
            raise MismatchError("1 < p/q < 2", f"p/q = {self.p / self.q:g}")


class Gains(NamedTuple):
    """Parameters for compiled code; arrays of shape (d,)."""

    surface: Array
    reach: Array
    beta: Array
    power: float
    margin: float
    adapt: float
    potential: Potential


@inlined
def bound_change(u, change, max_force, length, outward):
    """Keep u within max_force, in place: no outward rate at the bound, no rate above SLEW.

    Deep inside a potential, where only a collision can push a satellite, the gradient is so steep
    that an unlimited rate overflows within a few steps.
    """
    d = u.shape[0]
    if length > max_force**2 and outward > 0.0:
        for i in range(d):
            change[i] -= u[i] * outward / length
    speed = 0.0
    for i in range(d):
        speed += change[i] * change[i]
    if speed > (SLEW * max_force) ** 2:
        shrink = SLEW * max_force / np.sqrt(speed)
        for i in range(d):
            change[i] *= shrink


@compiled_rate(Gains)
def rate(gains, law_state, own, neighbours, world, t, force, change):
    """Write the force and the rate of the law's state, see `testbed.core.law`."""
    d = own.p.shape[0]
    u, bound = law_state[:d], law_state[d]
    force[:] = u
    shorten(force, own.max_force)
    power = gains.power
    e, g = scratch((3, d)), scratch((3, d))
    gradient(gains.potential, own, force, neighbours, world, e, g)
    length = outward = spread = slow = steep = 0.0
    for i in range(d):
        s = gains.surface[i] * g[0, i] + e[1, i]  # Eq. (15)
        s_dot = gains.surface[i] * g[1, i] + e[2, i]  # Eq. (22)
        sign, size = np.sign(s_dot), abs(s_dot)
        curve = size**power
        # size^(2 - p/q) and size^(p/q - 1) from one power: a power is a third of the law's time
        back, lever = (size * size / curve, curve / size) if curve > 0.0 else (0.0, 0.0)
        sigma = s + sign * curve / gains.beta[i]  # Eq. (24)
        nominal = (  # Eq. (28)
            world.goal.jerk[i]
            - own.disturbance_rate[i]
            - gains.surface[i] * g[2, i]
            - gains.beta[i] / power * sign * back
        )
        switching = -gains.reach[i] * sigma - (bound + gains.margin) * np.sign(sigma)  # Eq. (28)
        change[i] = own.mass * (nominal + switching)
        length += u[i] * u[i]
        outward += u[i] * change[i]
        spread += sigma * sigma
        slow += lever * lever
        steep = max(steep, 1.0 / gains.beta[i])
    change[d] = gains.adapt * power * steep * np.sqrt(slow * spread)  # Eq. (28), last line
    bound_change(u, change, own.max_force, length, outward)
    if length > own.max_force**2:  # removes what chattering along the bound has added
        leak = PULL * (1.0 - own.max_force / np.sqrt(length))
        for i in range(d):
            change[i] -= leak * u[i]


def initial(own: Body) -> Array:
    """Initial state: u = 0 and no disturbance known, shape (d + 1,)."""
    return np.zeros(own.p.shape[0] + 1)


def sotsmc(params: SotsmcParams, d: int) -> Law:
    """The law for positions of shape (d,), in the paper's units."""
    gains = Gains(
        diagonal(params.surface, d),
        diagonal(params.k, d),
        diagonal(params.beta, d),
        params.p / params.q,
        params.epsilon,
        params.eta,
        potential(params.potential, d),
    )
    return CompiledLaw(gains, initial, rate)
