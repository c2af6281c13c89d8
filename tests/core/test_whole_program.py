"""Compiled functions that call each other: linked whole, for our own entries and for others'."""

import numba
import numpy as np
import pytest

from testbed.core.compiled import compiled, inlined


@compiled
def innermost(x):
    if x[0] < 0.0:
        raise ValueError("expected a positive number")
    return 3.0 * x[0]


@inlined
def inner(x):
    return innermost(x) + x.sum()


@compiled
def left(x):
    return inner(x) + 1.0


@compiled
def right(x):
    return innermost(x) - inner(x)


@compiled
def both(x):
    """`innermost` is called along four ways, and before and after other functions."""
    return left(x) * right(x) + innermost(x)


@numba.njit
def of_a_user(x):
    return both(x)


@compiled
def writes(rows, x):
    rows[:2] = x
    return rows


X = np.array([2.0, 5.0, 0.25])


@pytest.mark.parametrize("way", [both, of_a_user])
def test_what_calls_many_parts_gives_what_plain_python_gives(way):
    assert way(X) == both.py_func(X)


def test_no_machine_code_is_made_of_a_part():
    both(X)
    part = next(iter(innermost.part.overloads.values()))
    assert part.library.get_pointer_to_function(part.fndesc.llvm_func_name) == 0


def test_an_error_deep_inside_reaches_the_caller():
    for way in (both, of_a_user):
        with pytest.raises(ValueError, match="expected a positive number"):
            way(-X)
    with pytest.raises(ValueError, match="cannot assign slice"):
        writes(np.zeros(3), X)


def test_a_function_is_called_from_python_and_from_compiled_code():
    assert (innermost(X), left(X)) == (6.0, 6.0 + 7.25 + 1.0)
