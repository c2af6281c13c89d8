r"""gao2022's law for a whole cluster at once, as `sim_twin.orbit.swarm` flies it.

The same field and repulsion as `controllers.bifurcating`, but each pair is evaluated once instead
of twice. Drift is that of Clohessy and Wiltshire, with the axes of the paper: x forward, y against
the normal, z down.

    as_printed    selects an error of the print to keep, to show its effect
    RIGHT         none
    ATTRACT       Eq. (13) with the printed sign
    POTENTIAL     Eq. (12) with the printed factor, U = -k_c (d^2 - s d), whose force replaces (13)
    INERTIAL      Eq. (10) with the velocity in ECI, mostly that of the centre
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.bifurcating import (
    BifurcatingParams,
    Gains,
    Phase,
    bifurcating,
    write_formation_force,
)
from controllers.repulsion import pairs
from sim_twin.orbit.clohessy_wiltshire import drift_all
from sim_twin.orbit.system import compiled_control
from testbed.core.compiled import borrowed, compiled

Array = NDArray[np.float64]

RIGHT, ATTRACT, INERTIAL, POTENTIAL = range(4)


class Cluster(NamedTuple):
    """The law and the parameters of the satellites."""

    gains: Gains
    mass: float  # of each [kg]
    w: float  # mean motion of the centre [rad/s]
    speed: float  # of the centre in ECI [m/s]
    as_printed: int


@compiled
def printed_potential(stiffness, reach, x, force):
    """Write the force of Eq. (12) as printed, k_c (2 - s/d) x_ij for d < s; all (n, 3)."""
    force[:] = 0.0
    for i in range(x.shape[0]):
        for j in range(i):
            d2 = 0.0
            for a in range(3):
                d2 += (x[i, a] - x[j, a]) ** 2
            if 0.0 < d2 < reach * reach:
                push = stiffness * (2.0 - reach / np.sqrt(d2))
                for a in range(3):
                    one = push * (x[i, a] - x[j, a])
                    force[i, a] += one
                    force[j, a] -= one


@compiled_control(Cluster)
def cluster_control(control, t, p, v, u):
    """Write the commanded accelerations of n satellites, (n, 3)."""
    control, p, v, u = borrowed((control, p, v, u))  # counting references took half the time
    g, k = control.gains, 0
    while k + 1 < g.at.shape[0] and g.at[k + 1] <= t:
        k += 1
    drift = np.empty_like(p)
    drift_all(control.w, p, v, drift)
    if control.as_printed == POTENTIAL:
        printed_potential(g.k_c[k], g.s[k], p, u)
    else:
        pairs(g.k_c[k], g.s[k], p, u)  # Eqs. (13), (14)
    if control.as_printed == ATTRACT:
        u *= -1.0
    lead = control.speed if control.as_printed == INERTIAL else 0.0
    force = np.empty(3)
    for i in range(p.shape[0]):
        write_formation_force(g, k, p[i], force)  # Eq. (23), (26)
        for a in range(3):
            speed = v[i, a] + (lead if a == 0 else 0.0)
            force[a] += u[i, a] - g.k_v[k] * speed  # Eq. (10)
            u[i, a] = force[a] / control.mass - drift[i, a]


def cluster(phases: tuple[Phase, ...], mass: float, w: float) -> Cluster:
    """The control for formations in SI units."""
    law = bifurcating(BifurcatingParams(phases=phases, centre=(0.0, 0.0, 0.0)), 3)
    return Cluster(law.gains, mass, w, 0.0, RIGHT)  # type: ignore[attr-defined]


def in_metres(phase: Phase, newtons: float) -> Phase:
    """A phase of the paper, in km, kg and s, in SI units.

    Args:
        phase: as printed; `at` is in seconds already.
        newtons: the paper's unit of force [N]: 1000 if coherent (kN), 1 for newtons.
    """
    length = {n: None if (x := getattr(phase, n)) is None else 1e3 * x for n in _LENGTHS}
    return Phase(
        at=phase.at, a=phase.a, b=phase.b, c=phase.c,
        k_f=newtons * 1e-6 * (phase.k_f or 0.0), k_v=newtons * 1e-3 * (phase.k_v or 0.0),
        k_c=newtons * 1e-3 * (phase.k_c or 0.0), **length,
    )  # fmt: skip


_LENGTHS = ("r", "mu", "sigma", "s")
