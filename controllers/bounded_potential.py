r"""Bounded potential between two proxies: finite at both ends, so finite forces can follow it.

Source: X. Xue, X. Wang, N. Han, "Leader-following connectivity preservation and collision avoidance
control for multiple spacecraft with bounded actuation", Aerospace 11:612, 2024, Eqs. (6)-(8); the
same as (3)-(5) of X. Xue, X. Yue, J. Yuan, ICGNC 2020, Springer 2022. Equation numbers are those of
2024.

    paper            code              meaning                                          unit
    |p_ij hat|       x                 distance of two proxies                          m
    d_ij             d                 desired distance                                 m
    delta hat        near              lower end, psi = Q                               m
    Delta hat        far               upper end, psi = Q                               m
    Q                height            psi at the ends                                  m^2
    P                -                 the caller's factor in J = P psi                 N/m

psi(d) = psi'(d) = 0. The stiffness at d differs a lot between the two sides, psi''(d) =
2 (d - near) / [(far - d) + (d - near) (far - d)^2 / Q] on the far side and
2 (far - d) / [(d - near) + (d - near)^2 (far - d) / Q] on the near one: put d in the middle.

The papers leave psi outside [near, far] open, but real distances, and those of the proxies, reach
from delta to Delta. Here psi continues with the slope at its end: a zero slope would give up the
link, and the formula's denominator changes sign. With d >= far only the repulsion exists; it ends
at far, where psi = 0 but psi' is not: the force jumps there, the energy does not.
"""

from typing import NamedTuple

from testbed.core.compiled import compiled


class BoundedPotential(NamedTuple):
    """Parameters of the potential: its ends and its height there."""

    near: float  # [m]
    far: float  # [m]
    height: float  # Q [m^2]


@compiled
def inside(u, x, d):
    """Psi [m^2] and its slope [m] for x in [near, far]."""
    if x <= d:  # Eq. (7)
        weight = (d - u.near) ** 2 / u.height
        top = (x - d) ** 2 * (u.far - x)
        top_slope = 2.0 * (x - d) * (u.far - x) - (x - d) ** 2
        bottom = (x - u.near) + weight * (u.far - x)
        bottom_slope = 1.0 - weight
    else:  # Eq. (8)
        weight = (u.far - d) ** 2 / u.height
        top = (x - u.near) * (x - d) ** 2
        top_slope = (x - d) ** 2 + 2.0 * (x - u.near) * (x - d)
        bottom = (u.far - x) + weight * (x - u.near)
        bottom_slope = weight - 1.0
    return top / bottom, (top_slope * bottom - top * bottom_slope) / bottom**2


@compiled
def bounded_potential(u, x, d):
    """Psi [m^2] and its slope [m] at distance `x`, zero at the desired distance `d`."""
    if x > u.far and d >= u.far:
        return 0.0, 0.0
    end = min(max(x, u.near), u.far)
    value, slope = inside(u, end, d)
    return value + slope * (x - end), slope
