"""Who is tied to whom: a proximity graph with a memory, and what the laws' proofs ask of it.

Sources: X. Xue, X. Yue, J. Yuan, "Connectivity preservation and collision avoidance control for
spacecraft formation flying in the presence of multiple obstacles", Adv. Space Res. 67, 2021; the
same, "... with bounded actuation", ICGNC 2020, Springer 2022; X. Xue, X. Wang, N. Han,
"Leader-following connectivity preservation and collision avoidance control for multiple spacecraft
with bounded actuation", Aerospace 11:612, 2024.

    paper              code            meaning                                             unit
    Delta              range           beyond it two satellites do not hear each other     m
    delta              safe            nearer than this they collide                       m
    Delta hat          far             Delta - epsilon_1: the potential ends here          m
    delta hat          near            delta + epsilon_2: and here                         m
    Delta bar          join            Delta - zeta_2: a new edge is added below this      m
    d_ij               desired[i, j]   desired distance                                    m
    E(0)               first[i, j]     1 for an edge of the start                          -
    a_ij               edge[j]         1 for an edge now, part of the law's state of i     -
    H                  pinned          Laplacian of the followers + diag(a_i0)             -

The leader of 2024 is the last row and column of `desired` and `first`, whether there is one or not.

Corrections to the print: Eq. (2) of 2022 and 2024 drops an edge as soon as its length leaves
(delta bar, Delta bar), and with it the force that should have kept it there. Here an edge of E(0)
is dropped at Delta only, where it cannot be heard any more, any other edge too (hysteresis), and no
edge is dropped for being short.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from testbed.core.compiled import compiled
from testbed.core.vehicle import NonNegative, Positive

Array = NDArray[np.float64]

LEADER = "leader"  # how the leader is called in `distances` and `edges`


# What a law's parameters declare as `forms`: desired lengths of the edges of a graph, of a graph
# with a leader as one more node, or curves to be on. No vehicle of such a law has its own goal.
FormationKind = Literal["graph", "led graph", "curves"]


def formation_kind(params: object) -> FormationKind | None:
    """What the law of these parameters forms; None if each vehicle has its own goal."""
    return getattr(params, "forms", None)


class FormationParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Shape and ranges, in the paper's units.

    `distances` has one entry for each pair of satellites, `"a-b" = 1.5`, and one for each that may
    hear the leader, `"a-leader" = 1.0`. A distance at or beyond the far margin means: not nearer
    than that. `edges` are those of the start, `["a-b", "a-leader"]`; null: every pair whose desired
    distance is inside the far margin.
    """

    range: Positive  # Delta [m]
    safe: Positive  # delta [m]
    distances: dict[str, Positive]  # [m]
    edges: tuple[str, ...] | None = None  # E(0)
    far_margin: Positive = 1.0  # epsilon_1 [m]
    near_margin: Positive = 1.0  # epsilon_2 [m]
    join_margin: NonNegative | None = None  # zeta_2; null: as far_margin [m]

    def __post_init__(self) -> None:
        if not self.near < self.far:
            raise ValueError(
                f"expected safe + near_margin < range - far_margin, "
                f"found {self.near:g} m and {self.far:g} m"
            )

    @property
    def near(self) -> float:
        """Shortest distance of an edge that the potential knows [m]."""
        return self.safe + self.near_margin

    @property
    def far(self) -> float:
        """Longest [m]."""
        return self.range - self.far_margin

    @property
    def join(self) -> float:
        """Below it a pair becomes an edge [m]."""
        margin = self.far_margin if self.join_margin is None else self.join_margin
        return self.range - margin


class Formation(NamedTuple):
    """The same, for compiled code; n satellites and, last, the leader."""

    range: float  # [m]
    near: float  # [m]
    far: float  # [m]
    join: float  # [m]
    desired: Array  # (n + 1, n + 1); 0: this pair never interacts [m]
    first: Array  # (n + 1, n + 1) 1 for an edge of E(0)


def pair(text: str, names: Sequence[str]) -> tuple[int, int]:
    """Indices of the two names in "a-b"; a name may contain hyphens itself."""
    cuts = [i for i, letter in enumerate(text) if letter == "-"]
    splits = [(text[:i], text[i + 1 :]) for i in cuts]
    found = [(a, b) for a, b in splits if a in names and b in names]
    known = ", ".join(names)
    if not found:
        raise ValueError(f'expected a pair "a-b" of {known}, found "{text}"')
    if len(found) > 1:
        raise ValueError(f'"{text}" can be read as more than one pair of {known}: rename one')
    a, b = found[0]
    if a == b:
        raise ValueError(f'expected two different names, found "{text}"')
    return names.index(a), names.index(b)


def _desired(params: FormationParams, names: Sequence[str], led: bool) -> Array:
    everybody = [*names, LEADER]
    desired = np.zeros((len(everybody), len(everybody)))
    for text, distance in params.distances.items():
        i, j = pair(text, everybody if led else names)
        if desired[i, j] != 0.0:
            raise ValueError(f'the distance of "{text}" is given twice: remove one')
        if distance <= params.near:
            raise ValueError(
                f'distance of "{text}": expected more than safe + near_margin = {params.near:g} m, '
                f"found {distance:g} m"
            )
        desired[i, j] = desired[j, i] = distance
    for i, name in enumerate(names):
        for j in range(i):
            if desired[i, j] == 0.0:
                raise ValueError(
                    f'no distance for "{names[j]}-{name}": give one; at {params.far:g} m or more '
                    "it only keeps them from coming nearer"
                )
    return desired


def _first(params: FormationParams, names: Sequence[str], desired: Array, led: bool) -> Array:
    if params.edges is None:
        return np.where((desired > 0.0) & (desired < params.far), 1.0, 0.0)
    first = np.zeros_like(desired)
    for text in params.edges:
        i, j = pair(text, [*names, LEADER] if led else names)
        if desired[i, j] == 0.0:
            raise ValueError(f'edge "{text}" has no desired distance: give one')
        if desired[i, j] >= params.far:
            raise ValueError(
                f'edge "{text}" cannot reach its desired distance: expected less than '
                f"range - far_margin = {params.far:g} m, found {desired[i, j]:g} m"
            )
        first[i, j] = first[j, i] = 1.0
    return first


def formation(params: FormationParams, names: Sequence[str], led: bool = False) -> Formation:
    """Parameters as the compiled code wants them.

    Args:
        params: with pairs by name.
        names: of all satellites, in the order of `Body.vehicle_index`.
        led: whether there is a leader.

    Raises:
        ValueError: a name, distance or edge is wrong, or the edges leave somebody alone.
    """
    names = list(names)
    if LEADER in names:
        raise ValueError(f'a satellite is called "{LEADER}", which means the goal here: rename it')
    desired = _desired(params, names, led)
    first = _first(params, names, desired, led)
    alone = unreached(first if led else first[:-1, :-1], len(names) if led else 0)
    if alone:
        whom = ", ".join([*names, LEADER][i] for i in alone)
        raise ValueError(
            f"the graph of the start is not connected: no path of edges leads from "
            f"{LEADER if led else names[0]} to {whom}; add an edge"
        )
    return Formation(params.range, params.near, params.far, params.join, desired, first)


def unreached(adjacency: Array, start: int = 0) -> list[int]:
    """Vertices that no path of edges joins to `start`."""
    reached, ahead = {start}, [start]
    while ahead:
        for j in np.flatnonzero(adjacency[ahead.pop()] > 0.0).tolist():
            if j not in reached:
                reached.add(j)
                ahead.append(j)
    return [i for i in range(len(adjacency)) if i not in reached]


def laplacian(adjacency: Array) -> Array:
    """L, shape of `adjacency`."""
    return np.diag(adjacency.sum(axis=1)) - adjacency


def pinned(adjacency: Array) -> Array:
    """H of the followers, (n, n), from an adjacency (n + 1, n + 1) with the leader last."""
    return laplacian(adjacency[:-1, :-1]) + np.diag(adjacency[:-1, -1])


def smallest_eigenvalue(h: Array) -> float:
    """Of a symmetric matrix; of H it is positive if everybody has a path to the leader."""
    return float(np.linalg.eigvalsh(h)[0])


def proximity(positions: Array, reach: float) -> Array:
    """Adjacency (n, n) of all pairs nearer than `reach`, for positions (n, d) [m]."""
    gap = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    return np.where((gap < reach) & ~np.eye(len(positions), dtype=bool), 1.0, 0.0)


@compiled
def distance(a, b):
    """Between two points, shape (d,) [m]."""
    total = 0.0
    for i in range(a.shape[0]):
        total += (a[i] - b[i]) ** 2
    return np.sqrt(total)


@compiled
def edge_after(formation, edge, i, j, gap):
    """a_ij, that was `edge`, when the distance is `gap`."""
    if formation.desired[i, j] == 0.0 or gap >= formation.range:
        return 0.0
    return 1.0 if gap < formation.join else edge


@compiled
def remember(formation, law_state, start, own, neighbours, world):
    """The law's state with a_ij brought up to date, from real positions.

    Args:
        formation: ranges and desired distances.
        law_state: its elements from `start` on are a_ij of this satellite, leader last.
        start: where they start.
        own: this satellite.
        neighbours: those heard; an edge to somebody else stays what it was.
        world: its goal is the leader.

    Returns:
        a new law state.
    """
    after = law_state.copy()
    i, n = own.vehicle_index, formation.desired.shape[0] - 1
    for k in range(neighbours.p.shape[0]):
        j = neighbours.vehicle_index[k]
        if j < 0:
            continue  # does not belong to the formation
        gap = distance(own.p, neighbours.p[k])
        after[start + j] = edge_after(formation, law_state[start + j], i, j, gap)
    gap = distance(own.p, world.goal.p)
    after[start + n] = edge_after(formation, law_state[start + n], i, n, gap)
    return after
