r"""Unbounded potentials between satellites, and between a satellite and an obstacle.

Source: X. Xue, X. Yue, J. Yuan, "Connectivity preservation and collision avoidance control for
spacecraft formation flying in the presence of multiple obstacles", Adv. Space Res. 67:3504, 2021.
Equation numbers are that paper's.

    paper               code               meaning                                       unit
    |p_ij|              x                  distance                                      m
    d_ij, d_ik^o        d                  desired distance; start of obstacle repulsion m
    delta_ij, delta^o   safe               collision distance                            m
    Delta               range              communication range                           m
    epsilon             margin             forces stop growing this far from both        m
    k_r, k_a, k_d       repel, attract, wish    gains                                    -, -, m

Corrections to the print: (29) is not the primitive of (30), which is right; the factors in front of
the logarithms are d - delta and Delta - d. (4) selects the potential by the distance at the start,
so that an edge that began shorter than d could be lost; here psi^a acts on every edge of E(0) and
psi^d on every other pair.
"""

from typing import NamedTuple

import numpy as np

from testbed.core.compiled import compiled


class LogPotential(NamedTuple):
    """Gains and ranges of the logarithmic potential."""

    repel: float
    attract: float
    wish: float  # [m]
    safe: float  # [m]
    range: float  # [m]
    margin: float  # [m]


@compiled
def repulsion(u, x, d, safe):
    """psi^r [m] and its slope for x <= d, both 0 beyond."""
    if x >= d:
        return 0.0, 0.0
    end = max(x, safe + u.margin)
    a, gap = d - safe, end - safe
    value = u.repel * ((gap - a) - a * np.log(gap / a))  # Eq. (29)
    slope = u.repel * (end - d) / gap  # Eq. (30)
    return value + slope * (x - end), slope


@compiled
def attraction(u, x, d):
    """psi^a [m] and its slope for x > d."""
    end = min(x, u.range - u.margin)
    a, gap = u.range - d, u.range - end
    value = u.attract * ((gap - a) - a * np.log(gap / a))  # Eq. (29)
    slope = u.attract * (end - d) / gap  # Eq. (30)
    return value + slope * (x - end), slope


@compiled
def wish(u, x, d):
    """psi^d [m] and its slope for x > d; constant beyond the range."""
    if x >= u.range:
        return 2.0 * u.wish, 0.0
    angle = np.pi * (x - d) / (u.range - d)
    slope = u.wish * np.pi / (u.range - d) * np.sin(angle)  # Eq. (30)
    return u.wish * (1.0 - np.cos(angle)), slope  # Eq. (29)


@compiled
def log_potential(u, x, d, held):
    """psi^f [m] and its slope at distance `x`; `held`: an edge of E(0)."""
    if x <= d:
        return repulsion(u, x, d, u.safe)
    return attraction(u, x, d) if held else wish(u, x, d)  # Eq. (4)
