"""All chance in the twin comes from one seed; every part draws from a stream of its own.

A stream is known by its name, so adding a vehicle or a camera does not change what the others draw.
"""

from collections.abc import Callable, Iterator
from itertools import chain

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AT_ONCE = 256  # rows: a call for each would cost more than the rows
A_FEW = 16  # the same for what there are many of: they would fill the cache


def stream(seed: int, *name: str) -> np.random.Generator:
    """The generator of the part called `name`, for instance ("sat1", "camera")."""
    key = tuple("/".join(name).encode())
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


class Draws:
    """Rows of random numbers, taken a few at a time and drawn many at a time.

    What is taken does not depend on how it is taken: a generator gives the same numbers one by one.
    """

    def __init__(self, draw: Callable[[tuple[int, int]], Array], width: int) -> None:
        """Rows of `width` numbers by `draw`, a method of a generator."""
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
    """The same one row at a time, as plain numbers; for parts of which there are many."""
    blocks = iter(lambda: draw((A_FEW, width)).tolist(), None)
    return chain.from_iterable(blocks)
