"""The proximity graph of the formation laws, with hysteresis, and the properties their proofs use.

Sources: X. Xue, X. Yue, J. Yuan, "Connectivity preservation and collision avoidance control for
spacecraft formation flying in the presence of multiple obstacles", Adv. Space Res. 67, 2021; the
same, "... with bounded actuation", ICGNC 2020, Springer 2022; X. Xue, X. Wang, N. Han,
"Leader-following connectivity preservation and collision avoidance control for multiple spacecraft
with bounded actuation", Aerospace 11:612, 2024.

    paper              code            meaning                                             unit
    Delta              range           communication range                                 m
    delta              safe            collision distance                                  m
    Delta hat          far             Delta - epsilon_1: upper end of the potential       m
    delta hat          near            delta + epsilon_2: lower end of the potential       m
    Delta bar          join            Delta - zeta_2: a new edge is added below this      m
    d_ij               desired[i, j]   desired distance                                    m
    E(0)               first[i, j]     1 for an edge of the start                          -
    a_ij               edge[j]         1 for a present edge, part of the law's state of i  -
    H                  pinned          Laplacian of the followers + diag(a_i0)             -

The leader of 2024 is the last row and column of `desired` and `first`, present even without a
leader.

Corrections to the print: Eq. (2) of 2022 and 2024 drops an edge as soon as its length leaves
(delta bar, Delta bar), and with it the force that should have kept it there. Here every edge is
dropped only at Delta, where the neighbour can no longer be heard (hysteresis), and no edge is
dropped for being short.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from testbed.core.compiled import compiled
from testbed.core.error import MismatchError
from testbed.core.vehicle import NonNegative, Positive

Array = NDArray[np.float64]

LEADER = "leader"  # name of the leader in `distances` and `edges`


# A law's parameters declare as `forms` what the law controls: edge lengths of a graph, edge lengths
# of a graph that includes a leader, or positions on curves. Its vehicles have no individual goals.
FormationKind = Literal["graph", "led graph", "curves"]


def formation_kind(params: object) -> FormationKind | None:
    """The kind of formation that the law of these parameters controls; None: one goal a vehicle."""
    return getattr(params, "forms", None)


class FormationParams(Struct, frozen=True, forbid_unknown_fields=True):
    """Shape and ranges, in the paper's units.

    `distances` has one entry for each pair of satellites, `"a-b" = 1.5`, and one for each satellite
    that may hear the leader, `"a-leader" = 1.0`. A pair with a distance at or beyond the far margin
    is only kept from coming nearer. `edges` are those of the start, `["a-b", "a-leader"]`; null:
    every pair whose desired distance is inside the far margin.
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
            raise MismatchError(
                "safe + near_margin < range - far_margin", f"{self.near:g} m and {self.far:g} m"
            )

    @property
    def near(self) -> float:
        """Lower end of the potential [m]."""
        return self.safe + self.near_margin

    @property
    def far(self) -> float:
        """Upper end of the potential [m]."""
        return self.range - self.far_margin

    @property
    def join(self) -> float:
        """Distance below which a pair becomes an edge [m]."""
        margin = self.far_margin if self.join_margin is None else self.join_margin
        return self.range - margin


class Formation(NamedTuple):
    """Parameters for compiled code; n satellites, then the leader."""

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
        raise MismatchError(f'a pair "a-b" of {known}', f'"{text}"')
    if len(found) > 1:
        raise ValueError(f'"{text}" is ambiguous, it matches several pairs of {known}: rename one')
    a, b = found[0]
    if a == b:
        raise MismatchError("two different names", f'"{text}"')
    return names.index(a), names.index(b)


def _desired(params: FormationParams, names: Sequence[str], led: bool) -> Array:
    everybody = [*names, LEADER]
    desired = np.zeros((len(everybody), len(everybody)))
    for text, distance in params.distances.items():
        i, j = pair(text, everybody if led else names)
        if desired[i, j] != 0.0:
            raise ValueError(f'the distance of "{text}" is given twice: remove one')
        if distance <= params.near:
            raise MismatchError(
                f"more than safe + near_margin = {params.near:g} m",
                f"{distance:g} m",
                f'distance of "{text}"',
            )
        desired[i, j] = desired[j, i] = distance
    for i, name in enumerate(names):
        for j in range(i):
            if desired[i, j] == 0.0:
                raise ValueError(
                    f'no distance for "{names[j]}-{name}": give one; a distance of '
                    f"{params.far:g} m or more only keeps them from coming nearer"
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
            raise MismatchError(
                f"less than range - far_margin = {params.far:g} m",
                f"{desired[i, j]:g} m",
                f'edge "{text}" cannot reach its desired distance',
            )
        first[i, j] = first[j, i] = 1.0
    return first


def formation(params: FormationParams, names: Sequence[str], led: bool = False) -> Formation:
    """Convert the parameters for compiled code.

    Args:
        params: with pairs by name.
        names: of all satellites, in the order of `Body.vehicle_index`.
        led: whether there is a leader.

    Raises:
        ValueError: a name, distance or edge is wrong, or the graph is not connected.
    """
    names = list(names)
    if LEADER in names:
        raise ValueError(f'a satellite is called "{LEADER}", the name of the goal here: rename it')
    desired = _desired(params, names, led)
    first = _first(params, names, desired, led)
    alone = unreached(first if led else first[:-1, :-1], len(names) if led else 0)
    if alone:
        whom = ", ".join([*names, LEADER][i] for i in alone)
        raise ValueError(
            f"the initial graph is not connected: no path of edges leads from "
            f"{LEADER if led else names[0]} to {whom}; add an edge"
        )
    return Formation(params.range, params.near, params.far, params.join, desired, first)


def unreached(adjacency: Array, start: int = 0) -> list[int]:
    """Vertices that no path of edges connects to `start`."""
    reached, ahead = {start}, [start]
    while ahead:
        for j in np.flatnonzero(adjacency[ahead.pop()] > 0.0).tolist():
            if j not in reached:
                reached.add(j)
                ahead.append(j)
    return [i for i in range(len(adjacency)) if i not in reached]


def laplacian(adjacency: Array) -> Array:
    """The graph Laplacian L, same shape as `adjacency`."""
    return np.diag(adjacency.sum(axis=1)) - adjacency


def pinned(adjacency: Array) -> Array:
    """H of the followers, (n, n), from an adjacency (n + 1, n + 1) with the leader last."""
    return laplacian(adjacency[:-1, :-1]) + np.diag(adjacency[:-1, -1])


def smallest_eigenvalue(h: Array) -> float:
    """Smallest eigenvalue, symmetric matrix; positive for H if the leader reaches all followers."""
    return float(np.linalg.eigvalsh(h)[0])


def proximity(positions: Array, reach: float) -> Array:
    """Adjacency (n, n) of pairs nearer than `reach` [m], for positions (n, d) [m]."""
    gap = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    return np.where((gap < reach) & ~np.eye(len(positions), dtype=bool), 1.0, 0.0)


@compiled
def distance(a, b):
    """Distance between two points of shape (d,) [m]."""
    total = 0.0
    for i in range(a.shape[0]):
        total += (a[i] - b[i]) ** 2
    return np.sqrt(total)


@compiled
def edge_after(formation, edge, i, j, gap):
    """New a_ij at distance `gap`; `edge` is the old value."""
    if formation.desired[i, j] == 0.0 or gap >= formation.range:
        return 0.0
    return 1.0 if gap < formation.join else edge


@compiled
def remember(formation, law_state, start, own, neighbours, world):
    """The law's state with a_ij updated from real positions.

    Args:
        formation: ranges and desired distances.
        law_state: its elements from `start` on are a_ij of this satellite, leader last.
        start: index of the first a_ij.
        own: this satellite.
        neighbours: those heard; edges to others do not change.
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
