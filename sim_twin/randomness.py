"""Random number streams of the twin: one seed, one independent stream for each part.

Streams are derived from names, so adding a vehicle or a camera does not change the others' numbers.
"""

from collections.abc import Callable, Iterator
from itertools import chain

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AT_ONCE = 256  # rows drawn per call: one call per row would dominate the cost
A_FEW = 16  # rows drawn per call for parts with many instances, to save CPU cache


def stream(seed: int, *name: str) -> np.random.Generator:
    """The generator of the part `name`, for instance ("sat1", "camera")."""
    key = tuple("/".join(name).encode())
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


class Draws:
    """A buffer of rows of random numbers, drawn many at a time.

    The numbers do not depend on the size of the blocks taken.
    """

    def __init__(self, draw: Callable[[tuple[int, int]], Array], width: int) -> None:
        """`draw`, a method of a generator, draws rows of `width` numbers."""
        self._draw, self._width = draw, width
        self._rows, self._count, self._next = np.empty((0, width)), 0, 0

    def take(self, n: int) -> Array:
        """The next rows, shape (n, width)."""
        start, end = self._next, self._next + n
        if end > self._count:
            fresh = self._draw((max(n, AT_ONCE), self._width))
            self._rows = np.concatenate((self._rows[start:], fresh))
            self._count, start, end = len(self._rows), 0, n
        self._next = end
        return self._rows[start:end]


def rows(draw: Callable[[tuple[int, int]], Array], width: int) -> Iterator[list[float]]:
    """Like `Draws`, one row at a time as a list; for parts with many instances."""
    blocks = iter(lambda: draw((A_FEW, width)).tolist(), None)
    return chain.from_iterable(blocks)
