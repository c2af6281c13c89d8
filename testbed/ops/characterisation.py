r"""What a group of satellites looks like as a whole: five numbers.

Source: Eq. (1)-(9) of W. Gao, K. Li, C. Wei, "Satellite Cluster Formation Reconfiguration Based on
the Bifurcating Potential Field", Aerospace 9:137, 2022.

    paper        code          meaning                                                    unit
    N            count         how many                                                   -
    r_o, v_o     p, v          mean position and velocity, in whatever frame is given     m, m/s
    d_max        outer         largest distance from the mean position                    m
    d_min        inner         smallest gap between two surfaces                          m
    L            uniformity    sum of (m_i / M)^3, m_i half the distance of the nearest   -
                               other, M half the largest d_ij + m_i + m_j

Corrections: Eq. (28), L of an even ring, is N (pi / (N + pi))^3, because Eq. (8) makes M = r + m_i
there and not r + 2 m_i.
What to know: M is half of the group's largest extent, not the radius of a ball around it (round an
equilateral triangle that is 7.7 % larger), so L may exceed what packing allows. Volumes are balls'
also for a group in a plane. Where satellites coincide, inner is zero or less and they add nothing
to L; where all do, L is zero. L says how even a group is, never how safe.

Any number of dimensions, no N x N array: nearest neighbours come from a k-d tree, M from a search
through pairs of boxes that drops those too near to each other to matter.
"""

from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from testbed.core.compiled import compiled

Array = NDArray[np.float64]

LEAF = 16  # satellites that are not divided further


class Characterisation(Struct, frozen=True):
    """The five elements; null where there are too few satellites for a number to mean anything."""

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
        velocities: shape (n, d) [m/s]; zero if there are none.
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
        tree = cKDTree(x)
        nearest, who = tree.query(x, k=2)
        half = nearest[:, 1] / 2.0  # m_i, Eq. (6)
        extent = largest_extent(x, half) / 2.0  # M, Eq. (8)
        evenness = float(np.sum((half / extent) ** 3)) if extent > 0.0 else 0.0  # Eq. (5), (7), (9)
        gap = smallest_gap(tree, x, a, nearest, who)
    return Characterisation(
        len(x), tuple(middle.tolist()), tuple(v.mean(axis=0).tolist()), outer, gap, evenness
    )


def ring_uniformity(count: int) -> float:
    """L of `count` satellites spread evenly over a circle, Eq. (28) corrected: arcs for chords."""
    return count * (np.pi / (count + np.pi)) ** 3


def smallest_gap(
    tree: cKDTree, x: Array, a: Array, nearest: Array, who: NDArray[np.int64]
) -> float:
    """Eq. (4): smallest d_ij - a_i - a_j [m]."""
    rows = np.arange(len(x))
    other = np.where(who[:, 0] == rows, who[:, 1], who[:, 0])  # twins may come first
    best = float(np.min(nearest[:, 1] - a - a[other]))
    if np.ptp(a) == 0.0:
        return best
    # a large one may be nearer with its surface than the nearest centre is
    for i, partners in enumerate(tree.query_ball_point(x, best + a + a.max())):
        far = np.array([j for j in partners if j > i], dtype=int)
        if len(far):
            gaps = np.linalg.norm(x[far] - x[i], axis=1) - a[i] - a[far]
            best = min(best, float(gaps.min()))
    return best


def largest_extent(x: Array, m: Array) -> float:
    """Largest d_ij + m_i + m_j over all pairs i != j [m].

    Pairs of boxes, the most promising first, are divided until none can beat the best pair found.
    Few pairs of boxes are looked at, even for a ring or a sphere, where very many pairs lie nearly
    opposite each other: ten times as many satellites take about twenty times as long.
    """
    order, first, end, low, high, most = boxes(x, m)
    return float(search(x[order], m[order], first, end, low, high, most))


def boxes(x: Array, m: Array) -> tuple[NDArray[Any], ...]:
    """A binary tree of boxes, each halved along its longest side; children of k: 2 k + 1, 2 k + 2.

    Returns:
        the order of the satellites; per box its first satellite, its last + 1, its lower and upper
        corner, and the largest m inside.
    """
    n, d = x.shape
    depth = max(0, int(np.ceil(np.log2(n / LEAF))))
    count = 2 ** (depth + 1) - 1
    order = np.arange(n)
    first, end = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
    low, high, most = np.empty((count, d)), np.empty((count, d)), np.empty(count)
    end[0] = n
    for k in range(count):
        a, b = first[k], end[k]
        inside = x[order[a:b]]
        low[k], high[k], most[k] = inside.min(axis=0), inside.max(axis=0), m[order[a:b]].max()
        if 2 * k + 2 < count:
            middle = (b - a) // 2
            side = int(np.argmax(high[k] - low[k]))
            order[a:b] = order[a:b][np.argpartition(inside[:, side], middle)]
            first[2 * k + 1], end[2 * k + 1] = a, a + middle
            first[2 * k + 2], end[2 * k + 2] = a + middle, b
    return order, first, end, low, high, most


@compiled
def reach(i, j, low, high, most):
    """No pair between the boxes i and j is larger than this."""
    total = 0.0
    for a in range(low.shape[1]):
        total += max(high[i, a] - low[j, a], high[j, a] - low[i, a]) ** 2
    return np.sqrt(total) + most[i] + most[j]


@compiled
def search(x, m, first, end, low, high, most):
    """See `largest_extent`; everything in the order of the boxes."""
    inner = first.shape[0] // 2  # boxes from here on are not divided
    best = 0.0
    stack = [(0, 0)]
    while len(stack) > 0:
        i, j = stack.pop()
        if reach(i, j, low, high, most) <= best:
            continue
        if i >= inner:
            for p in range(first[i], end[i]):
                for q in range(max(first[j], p + 1) if i == j else first[j], end[j]):
                    d2 = 0.0
                    for a in range(x.shape[1]):
                        d2 += (x[p, a] - x[q, a]) ** 2
                    best = max(best, np.sqrt(d2) + m[p] + m[q])
        else:
            a, b, c, d = 2 * i + 1, 2 * i + 2, 2 * j + 1, 2 * j + 2
            stack.append((a, c))
            stack.append((b, d))
            if i == j:
                stack.append((a, b))
            elif reach(a, d, low, high, most) < reach(b, c, low, high, most):
                stack.append((a, d))
                stack.append((b, c))
            else:
                stack.append((b, c))
                stack.append((a, d))
    return best
