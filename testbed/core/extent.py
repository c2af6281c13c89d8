"""Largest distance between any two of many points, each with its own margin.

Geometry without an N x N array; it is in this package because its compiled code is cached on disk.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.compiled import compiled

Array = NDArray[np.float64]

LEAF = 16  # points that are not divided further


def largest_extent(x: Array, m: Array) -> float:
    """Largest d_ij + m_i + m_j over all pairs i != j [m].

    Pairs of boxes, the most promising first, are divided until none can exceed the best pair found.
    Few pairs of boxes are visited, even for a ring or a sphere, where very many pairs are nearly
    opposite each other: ten times as many points take about twenty times as long.
    """
    if len(x) <= LEAF:  # one box, whatever its corners
        one, (n, d) = np.zeros(1, np.int64), x.shape
        return float(search(x, m, one, one + n, np.zeros((1, d)), np.ones((1, d)), np.ones(1)))
    order, first, end, low, high, most = boxes(x, m)
    return float(search(x[order], m[order], first, end, low, high, most))


def boxes(x: Array, m: Array) -> tuple[NDArray[Any], ...]:
    """A binary tree of boxes, each halved along its longest side; children of k: 2 k + 1, 2 k + 2.

    Returns:
        the points' order; per box its first point, its last + 1, its lower and upper
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
    """Upper bound of the pairs between the boxes i and j."""
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
