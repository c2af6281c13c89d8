"""Arrays lent to inner loops: the same memory, nobody counts, and it lives long enough."""

import sys
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from testbed.core.compiled import borrowed, keep


class Pair(NamedTuple):
    """Arrays in a tuple, as a law sees them."""

    one: NDArray[np.float64]
    other: NDArray[np.float64]


@numba.njit
def _sum_of(pair):
    return pair.one.sum() + pair.other.sum()


@numba.njit
def _sum_of_borrowed(n):
    one, other = np.full(n, 1.0), np.full(n, 2.0)
    lent = borrowed(Pair(one, other))
    total = 0.0
    for _ in range(3):
        total += _sum_of(lent)
        np.full(n, 7.0)  # would land in memory that was let go too early
    keep((one, other))
    return total


def test_what_is_borrowed_is_the_same_memory_and_lives_as_long_as_it_is_kept():
    assert _sum_of_borrowed(1000) == 3 * 3000.0


def test_borrowing_does_not_count():
    @numba.njit
    def writes_to(array):
        borrowed(array)[0] = 5.0

    array = np.zeros(3)
    before = sys.getrefcount(array)
    writes_to(array)
    assert array[0] == 5.0
    assert sys.getrefcount(array) == before
