r"""Describes a group of satellites by five numbers.

Source: Eq. (1)-(9) of W. Gao, K. Li, C. Wei, "Satellite Cluster Formation Reconfiguration Based on
the Bifurcating Potential Field", Aerospace 9:137, 2022.

    paper        code          meaning                                                    unit
    N            count         number of satellites                                       -
    r_o, v_o     p, v          mean position and velocity, in the given frame             m, m/s
    d_max        outer         largest distance from the mean position                    m
    d_min        inner         smallest gap between two surfaces                          m
    L            uniformity    sum of (m_i / M)^3, m_i half the distance of the nearest   -
                               other, M half the largest d_ij + m_i + m_j

Corrections: Eq. (28), L of an even ring, is N (pi / (N + pi))^3, because Eq. (8) gives M = r + m_i
there and not r + 2 m_i.

Notes: M is half of the group's largest extent, not the radius of an enclosing ball (for an
equilateral triangle that is 7.7 % larger), so L may exceed the packing limit. Volumes are those of
balls also for a group in a plane. If satellites coincide, inner is zero or less and they add
nothing to L; if all coincide, L is zero. L measures how even a group is, not how safe.

Any number of dimensions. Of more than FEW satellites nearest neighbours come from a k-d tree,
without an N x N array; M comes from a search through pairs of boxes that drops those too near to
each other to matter.
"""

from functools import cache
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import ArrayLike, NDArray

from testbed.core.extent import LEAF, largest_extent

Array = NDArray[np.float64]

FEW = 64  # scipy.spatial, which has the tree, takes a third of a second to import


class Characterisation(Struct, frozen=True):
    """The five elements; null if a number needs more satellites."""

    count: int
    p: tuple[float, ...]  # mean position [m]
    v: tuple[float, ...]  # mean velocity [m/s]
    outer: float  # [m]
    inner: float | None  # [m]
    uniformity: float | None  # [-]


def characterise(
    positions: ArrayLike, velocities: ArrayLike | None = None, radii: ArrayLike = 0.0
) -> Characterisation:
    """The five elements of a group.

    Args:
        positions: shape (n, d), n >= 1 [m].
        velocities: shape (n, d) [m/s]; zero if omitted.
        radii: of the satellites themselves, one or n of them [m].

    Raises:
        ValueError: shapes that do not fit, or a number that is not finite.
    """
    x = np.array(positions, dtype=float)
    if x.ndim != 2 or 0 in x.shape:
        raise ValueError(f"expected positions of shape (n, d), n >= 1, found {x.shape}")
    v = np.zeros_like(x) if velocities is None else np.array(velocities, dtype=float)
    if v.shape != x.shape:
        raise ValueError(f"expected velocities like positions, {x.shape}, found {v.shape}")
    size = np.asarray(radii, dtype=float)
    if size.shape not in ((), (len(x),)) or not np.all(size >= 0.0):
        raise ValueError(
            f"expected one radius or {len(x)}, none negative, found shape {size.shape}"
        )
    if not (np.all(np.isfinite(x)) and np.all(np.isfinite(v)) and np.all(np.isfinite(size))):
        raise ValueError("expected finite positions, velocities and radii")
    a = np.broadcast_to(size, (len(x),))
    middle = x.mean(axis=0)  # Eq. (1)
    outer = float(np.linalg.norm(x - middle, axis=1).max())  # Eq. (3)
    gap, evenness = None, None
    if len(x) > 1:
        nearest, gap = (among_few if len(x) <= FEW else among_many)(x, a)
        half = nearest / 2.0  # m_i, Eq. (6)
        extent = largest_extent(x, half) / 2.0  # M, Eq. (8)
        evenness = float(np.sum((half / extent) ** 3)) if extent > 0.0 else 0.0  # Eq. (5), (7), (9)
    return Characterisation(
        len(x), tuple(middle.tolist()), tuple(v.mean(axis=0).tolist()), outer, gap, evenness
    )


def characterise_each(positions: Array, velocities: Array) -> list[Characterisation]:
    """The five elements of a group at several times, to the last bit those of `characterise`.

    Args:
        positions: at each time, shape (m, n, d) [m].
        velocities: the same shape [m/s].
    """
    x, (_, n, _) = positions, positions.shape
    finite = np.isfinite(x).all() and np.isfinite(velocities).all()
    if not 1 < n <= LEAF or not finite:
        return [characterise(*both) for both in zip(positions, velocities, strict=True)]
    middle, i, (p, q) = x.mean(axis=1), np.arange(n), _pairs(n)
    outer = np.linalg.norm(x - middle[:, None], axis=2).max(axis=1)  # Eq. (3)
    apart = np.linalg.norm(x[:, :, None] - x[:, None], axis=3)
    pairs = apart[:, p, q]
    apart[:, i, i] = np.inf
    half = apart.min(axis=2) / 2.0  # m_i, Eq. (6)
    extent = (pairs + half[:, p] + half[:, q]).max(axis=1) / 2.0  # M, Eq. (8)
    shares = np.divide(half, extent[:, None], out=np.zeros_like(half), where=extent[:, None] > 0.0)
    columns = (
        middle.tolist(), velocities.mean(axis=1).tolist(), outer.tolist(),
        pairs.min(axis=1).tolist(), np.sum(shares**3, axis=1).tolist(),
    )  # fmt: skip
    return [
        Characterisation(n, tuple(p), tuple(v), *numbers)
        for p, v, *numbers in zip(*columns, strict=True)
    ]


@cache
def _pairs(n: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Each two of n satellites."""
    return np.triu_indices(n, 1)


def extremes(positions: Array, radii: Array) -> tuple[float, float]:
    """Smallest gap, Eq. (4), and largest distance from the mean, Eq. (3), over time.

    Args:
        positions: at each time, shape (m, n, d), n >= 2 [m].
        radii: of the satellites themselves, shape (n,) [m].
    """
    off = positions - positions.mean(axis=1, keepdims=True)
    gaps = [
        np.min(np.linalg.norm(positions[:, :i] - positions[:, i, None], axis=2) - radii[:i]) - a
        for i, a in enumerate(radii.tolist())
        if i > 0
    ]
    return float(min(gaps)), float(np.linalg.norm(off, axis=2).max())


def ring_uniformity(count: int) -> float:
    """L of `count` satellites spread evenly over a circle, Eq. (28) corrected: arcs for chords."""
    return count * (np.pi / (count + np.pi)) ** 3


def among_few(x: Array, a: Array) -> tuple[Array, float]:
    """Distance of the nearest other of each, and Eq. (4): smallest d_ij - a_i - a_j [m]."""
    apart = np.linalg.norm(x[:, None] - x, axis=2)
    np.fill_diagonal(apart, np.inf)
    return apart.min(axis=1), float((apart - a[:, None] - a).min())


def among_many(x: Array, a: Array) -> tuple[Array, float]:
    """What `among_few` gives, from a k-d tree."""
    from scipy.spatial import cKDTree

    tree = cKDTree(x)
    nearest, who = tree.query(x, k=2)
    return nearest[:, 1], _smallest_gap(tree, x, a, nearest[:, 1], who)


def _smallest_gap(
    tree: Any, x: Array, a: Array, nearest: Array, who: NDArray[np.int64]
) -> float:  # fmt: skip
    rows = np.arange(len(x))
    other = np.where(who[:, 0] == rows, who[:, 1], who[:, 0])  # a twin may be first
    best = float(np.min(nearest - a - a[other]))
    if np.ptp(a) == 0.0:
        return best
    # the surface of a large one may be nearer than the nearest centre
    for i, partners in enumerate(tree.query_ball_point(x, best + a + a.max())):
        far = np.array([j for j in partners if j > i], dtype=int)
        if len(far):
            gaps = np.linalg.norm(x[far] - x[i], axis=1) - a[i] - a[far]
            best = min(best, float(gaps.min()))
    return best
