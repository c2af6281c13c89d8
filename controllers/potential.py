r"""Artificial potential of zhang2023 and its derivatives along a trajectory.

Source: J. Zhang, Y. Wang, J. Jia, C. Chi, H. Li, "Collision avoidance second order sliding mode
control of satellite formation with air-floated platform semi-physical simulation",
Electronics 12:3179, 2023. Equation numbers are that paper's.

    paper          code                  meaning                                     unit
    e              e                     position error rho - rho_d                  m
    r_i            r                     rho - r_oi                                  m
    P, M           attract, repel        weights, diagonal                           -
    psi_i          height                height of the repulsive term                -
    N_i, sigma_i   spread, sigma         E_i = exp(-|r_i|^2 / width_i^2)             m
    R              design_radius         danger radius that N_i, sigma_i are for     m

Corrections to the print, because otherwise its own figures do not come out:
Eq. (14) is a product, U = e'Pe/2 + (e'Me)/2 sum psi_i E_i: only then is U zero at the goal and
Eq. (16) its gradient. In (16) the first repulsive term carries psi_i, not psi_i/sigma_i. N_i is
used inverted, width_i^2 = N_i sigma_i, because as printed the repulsion ends 2-3 m from the centre
of an obstacle of 50 m. Eqs. (18)-(20) inherit the slip in (16), so they are not transcribed: the
derivatives of the gradient follow from Leibniz' rule on the trajectory.

Differences from the paper: the width of a disc's potential grows with its danger radius (the paper
has one radius, 50 m), and `standoff` adds to every radius. It is needed because the repulsion is
proportional to e'Me: where a vehicle passes an obstacle close to its goal the barrier is thinner,
and with the paper's numbers the clearance falls to 0.98 of the danger radius. standoff = 0 is the
paper.
"""

from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from testbed.core.compiled import compiled
from testbed.core.vehicle import NonNegative, Positive

Array = NDArray[np.float64]

Diagonal = Positive | tuple[Positive, ...]  # one number for all axes, or one per axis


class PotentialParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Tables 2 and 6, in the paper's units."""

    attract: Diagonal = 0.012  # P
    repel: Diagonal = (0.8, 0.6, 0.4)  # M
    height: NonNegative = 5e3  # psi
    spread: Positive = 15.0  # N, inverted as said above
    sigma: Positive = 10.0
    design_radius: Positive = 50.0  # danger radius that the width is for [m]
    standoff: NonNegative = 0.0  # added to every danger radius [m]


class Potential(NamedTuple):
    """The same, for compiled code."""

    attract: Array  # (d,)
    repel: Array  # (d,)
    height: float
    width_ratio: float  # width / danger radius
    standoff: float  # [m]


def diagonal(value: float | tuple[float, ...], d: int) -> Array:
    """Diagonal of a d x d weight; a longer one is cut."""
    if isinstance(value, tuple):
        if len(value) < d:
            raise ValueError(f"expected {d} diagonal elements or one number, found {len(value)}")
        return np.array(value[:d], dtype=float)
    return np.full(d, float(value))


def potential(params: PotentialParams, d: int) -> Potential:
    """Parameters as the compiled code wants them, for positions of shape (d,)."""
    width = np.sqrt(params.spread * params.sigma)
    return Potential(
        diagonal(params.attract, d),
        diagonal(params.repel, d),
        params.height,
        float(width / params.design_radius),
        params.standoff,
    )


@compiled
def add_repulsion(u, width, r, r1, r2, e, e1, e2, g, g1, g2):
    """Add one disc's share of Eq. (16) to `g`, and of its first two time derivatives to g1, g2.

    With A = e'Me and S = psi exp(-|r|^2/width^2) the share is S M e - A S r/width^2. Every factor
    is differentiated along the trajectory; velocities of the obstacle and of the goal are inside
    r1 and e1, which is all that Eqs. (17)-(20) say.

    Args:
        u: the potential.
        width: of this disc [m].
        r, r1, r2: offset from the disc's centre and its time derivatives, shape (d,).
        e, e1, e2: position error and its time derivatives, shape (d,).
        g, g1, g2: sums so far, shape (d,), written to.
    """
    d = e.shape[0]
    q = q1 = q2 = 0.0  # |r|^2/width^2 and derivatives
    a = a1 = a2 = 0.0  # e'Me and derivatives
    w = 1.0 / (width * width)
    for i in range(d):
        q += r[i] * r[i] * w
        q1 += 2.0 * r[i] * r1[i] * w
        q2 += 2.0 * (r1[i] * r1[i] + r[i] * r2[i]) * w
        a += u.repel[i] * e[i] * e[i]
        a1 += 2.0 * u.repel[i] * e[i] * e1[i]
        a2 += 2.0 * u.repel[i] * (e1[i] * e1[i] + e[i] * e2[i])
    s = u.height * np.exp(-q)
    s1 = -q1 * s
    s2 = (q1 * q1 - q2) * s
    b = a * s * w
    b1 = (a1 * s + a * s1) * w
    b2 = (a2 * s + 2.0 * a1 * s1 + a * s2) * w
    for i in range(d):
        m = u.repel[i]
        g[i] += s * m * e[i] - b * r[i]  # Eq. (16)
        g1[i] += m * (s1 * e[i] + s * e1[i]) - (b1 * r[i] + b * r1[i])
        g2[i] += m * (s2 * e[i] + 2.0 * s1 * e1[i] + s * e2[i]) - (
            b2 * r[i] + 2.0 * b1 * r1[i] + b * r2[i]
        )


@compiled
def gradient(u, own, accel, neighbours, world):
    """Gradient of U where the satellite is, and how it changes on the way.

    Args:
        u: the potential.
        own: the satellite.
        accel: its nominal acceleration, shape (d,) [m/s^2].
        neighbours: discs to avoid.
        world: goal, and more discs.

    Returns:
        rows: nabla U, Eq. (16); Omega, its time derivative, Eq. (21); the time derivative of Omega;
        shape (3, d).
    """
    d = own.p.shape[0]
    g = np.zeros((3, d))
    e, e1, e2 = np.empty(d), np.empty(d), np.empty(d)
    for i in range(d):
        e[i] = own.p[i] - world.goal.p[i]
        e1[i] = own.v[i] - world.goal.v[i]
        e2[i] = accel[i] - world.goal.a[i]
        g[0, i] = u.attract[i] * e[i]  # Eq. (10)
        g[1, i] = u.attract[i] * e1[i]
        g[2, i] = u.attract[i] * e2[i]
    r, r1 = np.empty(d), np.empty(d)
    for discs in (world.obstacles, neighbours):
        for n in range(discs.p.shape[0]):
            for i in range(d):
                r[i] = own.p[i] - discs.p[n, i]
                r1[i] = own.v[i] - discs.v[n, i]
            width = u.width_ratio * (discs.radius[n] + u.standoff)
            add_repulsion(u, width, r, r1, accel, e, e1, e2, g[0], g[1], g[2])
    return g
