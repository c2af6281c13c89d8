r"""The potential Psi of the laws of xue2021 and its gradient.

Source: X. Xue, X. Yue, J. Yuan, "Connectivity preservation and collision avoidance control for
spacecraft formation flying in the presence of multiple obstacles", Adv. Space Res. 67:3504, 2021.
Equation numbers are that paper's. `log_potential` lists the symbols of the single potentials.

    paper            code                        meaning                                    unit
    K_f, K_o         pairs, obstacles            weights                                    N
    d^o - delta^o    obstacle_band               width of an obstacle's repulsion; 0: none  m
    a_ij             law_state[start:]           edges, see `graph`                         -
    E(0)             formation.first             edges of the start, which are kept         -

(9) sums over ordered pairs, so each edge counts twice: `pair_count` = 2 is the paper, 1 counts each
edge once. An obstacle's delta^o is the radius that the caller gives it.

Differences from the paper: obstacles act within d^o, which the paper requires to be below Delta, so
b_ik is not needed.
"""

from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from controllers.graph import Formation, FormationParams, distance, formation, remember
from controllers.log_potential import LogPotential, log_potential, repulsion
from testbed.core.compiled import compiled
from testbed.core.error import MismatchError
from testbed.core.law_verbs import compiled_jump
from testbed.core.vehicle import NonNegative, Positive

Array = NDArray[np.float64]


class FormationPotentialParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Section 4, in the paper's units; defaults are those of the static case."""

    k_f: Positive = 10.0  # [N]
    k_o: NonNegative = 10.0  # [N]
    k_r: Positive = 0.2
    k_a: Positive = 0.05
    k_d: NonNegative = 0.2  # [m]
    obstacle_band: NonNegative = 30.0  # [m]
    pair_count: Literal[1, 2] = 2


class FormationPotential(NamedTuple):
    """Parameters and formation for compiled code."""

    formation: Formation
    single: LogPotential
    pairs: float  # pair_count K_f
    obstacles: float
    band: float


def formation_potential(
    params: FormationPotentialParams, shape: FormationParams, names: Sequence[str]
) -> FormationPotential:
    """Convert the parameters for compiled code; epsilon is the smaller of the two margins."""
    margin = min(shape.far_margin, shape.near_margin)
    if 0.0 < params.obstacle_band <= margin:
        raise MismatchError(
            f"0 or more than the smaller margin, {margin:g} m",
            f"{params.obstacle_band:g} m",
            "obstacle_band",
        )
    return FormationPotential(
        formation(shape, names),
        LogPotential(params.k_r, params.k_a, params.k_d, shape.safe, shape.range, margin),
        params.pair_count * params.k_f,
        params.k_o,
        params.obstacle_band,
    )


@compiled
def add_gradient(slope, here, there, x, total):
    """Add `slope` along the line from `there` to `here`, of length `x`, to `total`."""
    if x > 0.0:
        for i in range(here.shape[0]):
            total[i] += slope * (here[i] - there[i]) / x


@compiled
def pairs_gradient(u, law_state, start, own, neighbours):
    """Gradient of the first sum of Eq. (9), shape (d,) [N]."""
    total = np.zeros(own.p.shape[0])
    for k in range(neighbours.p.shape[0]):
        j = neighbours.vehicle_index[k]
        if j < 0 or law_state[start + j] < 0.5:
            continue
        x = distance(own.p, neighbours.p[k])
        d = u.formation.desired[own.vehicle_index, j]
        held = u.formation.first[own.vehicle_index, j] > 0.5
        slope = log_potential(u.single, x, d, held)[1]
        add_gradient(u.pairs * slope, own.p, neighbours.p[k], x, total)
    return total


@compiled
def obstacle_gradient(u, own, obstacles, k):
    """Gradient of one obstacle's term of Eq. (9), shape (d,) [N]."""
    total = np.zeros(own.p.shape[0])
    if u.band == 0.0:
        return total
    x = distance(own.p, obstacles.p[k])
    safe = obstacles.radius[k]
    slope = repulsion(u.single, x, safe + u.band, safe)[1]  # Eq. (5)
    add_gradient(u.obstacles * slope, own.p, obstacles.p[k], x, total)
    return total


@compiled
def gradient(u, law_state, start, own, neighbours, world):
    """Gradient of Psi, Eq. (9), shape (d,) [N]; a_ij are in `law_state` from `start` on."""
    total = pairs_gradient(u, law_state, start, own, neighbours)
    for k in range(world.obstacles.p.shape[0]):
        total += obstacle_gradient(u, own, world.obstacles, k)
    return total


@compiled
def disagreement(law_state, start, mine, who, theirs):
    """Sum over the edges of `mine` (d,) minus each neighbour's row of `theirs`."""
    total = np.zeros(mine.shape[0])
    for k in range(theirs.shape[0]):
        if who[k] >= 0 and law_state[start + who[k]] > 0.5:
            for i in range(mine.shape[0]):
                total[i] += mine[i] - theirs[k, i]
    return total


def _jump(gains, law_state, own, neighbours, world, t):
    """Update the edges from real positions."""
    return remember(gains.potential.formation, law_state, 1, own, neighbours, world)


def with_edges(gains_type: type) -> Callable:
    """`jump` of a law whose state is a mass and a_ij, and whose gains have a `potential`."""
    return compiled_jump(gains_type)(_jump)
