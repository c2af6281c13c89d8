"""Windows linearised around flown poses, each without its initial state.

A fit needs products of errors and slopes only. So each window is reduced to these products at once,
and a choice among numbers or a fold of a cross-validation is a sum over windows, however many poses
they have. Windows do not depend on each other: they are reduced in blocks, which bounds the memory.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.identification.windows import Pushed, Windows, flown_with_slopes

Array = NDArray[np.float64]
BLOCK = 32  # windows that are reduced together; more need more memory
SMALL = 200_000  # multiplications of a product; for more BLAS starts threads, at 4 times the cost


class Pieces(NamedTuple):
    """Windows, linearised; `w` windows, `k` numbers, `n` poses together."""

    log: NDArray[np.int64]  # (w,)
    window: NDArray[np.int64]  # (w,)
    size: Array  # (w,) number of errors in each, three per pose
    error: Array  # (n, 3) measured minus flown, in units of the noise
    power: Array  # (w,) errors times errors
    side: Array  # (w, k) slopes of the flown poses times errors
    matrix: Array  # (w, k, k) slopes times slopes
    start: Array  # (w, 6) change of the initial state that leaves these errors
    follows: Array  # (w, 6, k) of it: what a change of each number takes away

    @property
    def square(self) -> Array:
        """Mean square error of each window, (w,)."""
        return self.power / self.size


def linearised(
    flights: Sequence[Sequence[Pushed]], steps: Array, logs: Sequence[Windows],
    states: Sequence[Array], scales: Array, ways: Sequence[Array] | None = None,
) -> Pieces:  # fmt: skip
    """All windows, linearised by some numbers.

    Args:
        flights: of each log: the vehicle as it is, and with each number changed.
        steps: the changes, shape (k,).
        logs: the windows.
        states: initial states of each log's windows, (w, 6).
        scales: noise of x, y and theta, shape (3,).
        ways: of each log: displacement of each pose by unit slopes at the nodes of a map,
            (w, m, nodes). The slopes along x, then along y, are numbers after the others.
    """
    parts = []
    for number, windows in enumerate(logs):
        for first in range(0, len(windows.begin), BLOCK):
            part = slice(first, first + BLOCK)
            way = None if ways is None else ways[number][part]
            own = flights[number], steps, number, windows, states[number], scales
            parts.append(_reduced(*own, part, way))
    return Pieces(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _reduced(
    flights: Sequence[Pushed], steps: Array, number: int, windows: Windows, states: Array,
    scales: Array, part: slice, way: Array | None,
) -> Pieces:  # fmt: skip
    """Some windows of a log; rows without a pose are zero."""
    flown, by_state = flown_with_slopes(flights[0], windows, states, part)
    use = np.isfinite(windows.marks[part])
    count, most = use.shape
    nodes, first = 0 if way is None else way.shape[2], 1 + len(steps)
    # errors, then slopes by each number
    columns = np.zeros((count, most, 3, first + 2 * nodes))
    columns[..., 0] = windows.seen[part] - flown
    for k, (nudged, step) in enumerate(zip(flights[1:], steps, strict=True), 1):
        columns[..., k] = (nudged.fly(windows, states, part) - flown) / step
    if way is not None:
        columns[:, :, 0, first : first + nodes] = way
        columns[:, :, 1, first + nodes :] = way
    for one in (columns, by_state):
        one[~use] = 0.0
        one /= scales[:, None]
    left = columns.reshape(count, 3 * most, -1)
    basis, triangle = np.linalg.qr(by_state.reshape(count, 3 * most, 6))
    along = _product(basis, left)
    left -= basis @ along
    both = _product(left, left)
    follows = np.linalg.solve(triangle, along)
    return Pieces(
        np.full(count, number), np.arange(count) + part.start, 3.0 * use.sum(axis=1),
        left[..., 0].reshape(count, most, 3)[use], both[:, 0, 0], both[:, 1:, 0], both[:, 1:, 1:],
        follows[..., 0], follows[..., 1:],
    )  # fmt: skip


def _product(a: Array, b: Array) -> Array:
    """`a` transposed times `b` for each window, in parts that BLAS does without threads."""
    size = a.shape[1] * a.shape[2] * b.shape[2]
    parts = min(a.shape[1], size // SMALL + 1)
    rows = np.linspace(0, a.shape[1], parts + 1).astype(int)
    total = np.zeros((len(a), a.shape[2], b.shape[2]))
    for first, last in pairwise(rows):
        total += a[:, first:last].swapaxes(1, 2) @ b[:, first:last]
    return total


def normal(pieces: Pieces, weights: Array) -> tuple[Array, Array]:
    """Normal equations: matrix and right-hand side; pieces of weight 0 are left out."""
    return np.tensordot(weights, pieces.matrix, 1), weights @ pieces.side
