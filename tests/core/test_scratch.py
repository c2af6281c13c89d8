"""Arrays on the stack look and work as those of numpy."""

import numpy as np
import pytest

from testbed.core.compiled import compiled, inlined
from testbed.core.scratch import scratch


@compiled
def filled(n):
    """What arrays of one to three axes hold and how they lie in memory."""
    line, square, cube = scratch(n), scratch((3, n)), scratch((2, n, 4))
    line[:], square[:], cube[:] = 1.0, 2.0, 3.0
    square[1, n - 1], cube[1, n - 1, 3] = 5.0, 7.0
    shapes = line.shape, square.shape, cube.shape
    strides = line.strides, square.strides, cube.strides
    return shapes, strides, (line.sum(), square.sum(), cube.sum()), square[1].sum()


@compiled
def squared(n):
    own = scratch(n)
    own[:] = float(n)
    return own.sum()


@compiled
def below(n):
    """A sum in an array that other functions must leave alone, and theirs."""
    own, total = scratch(n), 0.0
    own[:] = 1.0
    for k in range(1, n + 1):
        total += squared(k)
    return own.sum(), total


@inlined
def tripled(n):
    own = scratch(3)
    own[:] = float(n)
    return own.sum()


@compiled
def added(count):
    total = 0.0
    for k in range(count):
        total += tripled(k)
    return total


@pytest.mark.parametrize("n", [1, 2, 7, 1000])
def test_several_arrays_do_not_overlap(n):
    plain = getattr(filled, "py_func", filled)
    assert filled(n) == plain(n)


def test_each_call_has_its_own():
    assert below(30) == (30.0, sum(k * k for k in range(1, 31)))
    assert below(100_000)[0] == 100_000.0  # what a call has taken is given back


def test_an_inlined_function_may_be_called_in_a_loop():
    count = 1_000_000  # 24 MB, if it gave nothing back: more than the stack has
    assert added(count) == 3 * count * (count - 1) // 2


def test_rows_begin_where_a_processor_loads_them_at_once():
    @compiled
    def address(n):
        return scratch(n).ctypes.data, scratch(3).ctypes.data

    assert [place % 32 for place in address(5)] == [0, 0]


def test_plain_python_takes_it_from_numpy():
    assert isinstance(scratch((2, 3)), np.ndarray)
    assert scratch((2, 3)).shape == (2, 3)
