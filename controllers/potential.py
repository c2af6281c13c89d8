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

Corrections to the print; without them the paper's figures cannot be reproduced:
Eq. (14) is a product, U = e'Pe/2 + (e'Me)/2 sum psi_i E_i: only then is U zero at the goal and
Eq. (16) its gradient. In (16) the first repulsive term carries psi_i, not psi_i/sigma_i. N_i is
used inverted, width_i^2 = N_i sigma_i, because as printed the repulsion ends 2-3 m from the centre
of an obstacle of 50 m. Eqs. (18)-(20) inherit the error in (16), so they are not transcribed: the
derivatives of the gradient follow from the product rule along the trajectory.

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

from testbed.core.compiled import inlined
from testbed.core.error import MismatchError
from testbed.core.scratch import scratch
from testbed.core.vehicle import NonNegative, Positive

Array = NDArray[np.float64]

FAR = 80.0  # (|r|/width)^2 from which exp(-FAR) = 2e-35 is below rounding

Diagonal = Positive | tuple[Positive, ...]  # one number for all axes, or one per axis


class PotentialParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Tables 2 and 6, in the paper's units."""

    attract: Diagonal = 0.012  # P
    repel: Diagonal = (0.8, 0.6, 0.4)  # M
    height: NonNegative = 5e3  # psi
    spread: Positive = 15.0  # N, used inverted, see above
    sigma: Positive = 10.0
    design_radius: Positive = 50.0  # danger radius that the width is for [m]
    standoff: NonNegative = 0.0  # added to every danger radius [m]


class Potential(NamedTuple):
    """Parameters for compiled code."""

    attract: Array  # (d,)
    repel: Array  # (d,)
    height: float
    width_ratio: float  # width / danger radius
    standoff: float  # [m]


def diagonal(value: float | tuple[float, ...], d: int) -> Array:
    """Diagonal (d,) of a weight; surplus elements are dropped."""
    if isinstance(value, tuple):
        if len(value) < d:
            raise MismatchError(f"{d} diagonal elements or one number", f"{len(value)}")
        return np.array(value[:d], dtype=float)
    return np.full(d, float(value))


def potential(params: PotentialParams, d: int) -> Potential:
    """Convert the parameters for compiled code, for positions of shape (d,)."""
    width = np.sqrt(params.spread * params.sigma)
    return Potential(
        diagonal(params.attract, d),
        diagonal(params.repel, d),
        params.height,
        float(width / params.design_radius),
        params.standoff,
    )


@inlined
def add_repulsion(u, width, offset, error, g):
    """Add one disc's term of Eq. (16) and its first two time derivatives to the rows of `g`.

    With A = e'Me and S = psi exp(-|r|^2/width^2) the term is S M e - A S r/width^2. Every factor is
    differentiated along the trajectory, as in Eqs. (17)-(20); r' and e' contain the velocities of
    the obstacle and of the goal.

    Args:
        u: the potential.
        width: of this disc [m].
        offset: r from the disc's centre and its first two time derivatives, shape (3, d).
        error: e and its first two time derivatives, shape (3, d).
        g: sums so far, shape (3, d), written to.
    """
    d = error.shape[1]
    q = q1 = q2 = 0.0  # |r|^2/width^2 and derivatives
    a = a1 = a2 = 0.0  # e'Me and derivatives
    w = 1.0 / (width * width)
    for i in range(d):
        r, r1, r2 = offset[0, i], offset[1, i], offset[2, i]
        e, e1, e2 = error[0, i], error[1, i], error[2, i]
        q += w * r * r
        q1 += 2.0 * w * r * r1
        q2 += 2.0 * w * (r1 * r1 + r * r2)
        a += u.repel[i] * e * e
        a1 += 2.0 * u.repel[i] * e * e1
        a2 += 2.0 * u.repel[i] * (e1 * e1 + e * e2)
    s = u.height * np.exp(-q)
    s1 = -q1 * s
    s2 = (q1 * q1 - q2) * s
    b = a * s * w
    b1 = (a1 * s + a * s1) * w
    b2 = (a2 * s + 2.0 * a1 * s1 + a * s2) * w
    for i in range(d):
        r, r1, r2 = offset[0, i], offset[1, i], offset[2, i]
        e, e1, e2 = error[0, i], error[1, i], error[2, i]
        m = u.repel[i]
        g[0, i] += m * s * e - b * r  # Eq. (16)
        g[1, i] += m * (s1 * e + s * e1) - (b1 * r + b * r1)
        g[2, i] += m * (s2 * e + 2.0 * s1 * e1 + s * e2) - (b2 * r + 2.0 * b1 * r1 + b * r2)


@inlined
def add_repulsions(u, own, discs, offset, error, g):
    """Add the terms of all `discs`; overwrites all rows of `offset` but the last."""
    for n in range(discs.p.shape[0]):
        width = u.width_ratio * (discs.radius[n] + u.standoff)
        distance = 0.0
        for i in range(own.p.shape[0]):
            offset[0, i] = own.p[i] - discs.p[n, i]
            offset[1, i] = own.v[i] - discs.v[n, i]
            distance += offset[0, i] ** 2
        if distance < FAR * width * width:
            add_repulsion(u, width, offset, error, g)


@inlined
def gradient(u, own, force, neighbours, world, error, g):
    """Write position error, gradient of U and their time derivatives at the satellite's position.

    Args:
        u: the potential.
        own: the satellite.
        force: on it, shape (d,) [N].
        neighbours: discs to avoid.
        world: goal, and more discs.
        error: written: e and its first two time derivatives, shape (3, d), the second one with the
            nominal acceleration.
        g: written: nabla U, Eq. (16), and its first two time derivatives, shape (3, d). The first
            one is Omega of Eq. (21).
    """
    d = own.p.shape[0]
    offset = scratch((3, d))
    for i in range(d):
        accel = force[i] / own.mass + own.disturbance[i]
        error[0, i] = own.p[i] - world.goal.p[i]
        error[1, i] = own.v[i] - world.goal.v[i]
        error[2, i] = accel - world.goal.a[i]
        offset[2, i] = accel
        for k in range(3):
            g[k, i] = u.attract[i] * error[k, i]  # Eq. (10)
    add_repulsions(u, own, world.obstacles, offset, error, g)
    add_repulsions(u, own, neighbours, offset, error, g)
