"""Bundles: compiled code sees what Python sees, and changes it in place."""

from struct import Struct
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest

from testbed.core.bundle import Bundle, layout_of, unpacked
from testbed.core.code_cache import BundleType, _is_ours_throughout
from testbed.core.compiled import compiled, look_of


class Inner(NamedTuple):
    """Numbers of all sizes, so that some need padding."""

    first: bool
    second: bool
    whole: int
    third: bool
    grid: Any
    number: float


class Outer(NamedTuple):
    """A tuple of tuples, records and views."""

    one: Inner
    record: Any
    flags: Any
    two: Inner
    last: bool


def outer() -> Outer:
    """A value with views that are not contiguous."""
    record = np.zeros(2, np.dtype((np.record, [("a", np.int64), ("b", np.float64, (2,))])))
    grid = np.arange(24.0).reshape(4, 6)
    one = Inner(True, False, -7, True, grid[::2, 1:5], 2.5)
    two = Inner(False, True, 2**40, False, np.zeros((0, 3)), -0.0)
    return Outer(one, record, np.array([True, False]), two, True)


@compiled
def changed(bundle, by):
    """Read everything, and write to the arrays."""
    it = unpacked(bundle)
    it.one.grid[1, 2] += by
    it.record[1].b[0] = it.one.number
    it.record[0].a = it.two.whole
    seen = it.one.first, it.one.second, it.one.third, it.two.first, it.two.second, it.last
    return seen, it.one.grid.sum(), it.flags[0], it.two.grid.shape[0], it.one.whole


def test_compiled_code_sees_and_changes_what_python_sees():
    compiled_one, plain = outer(), outer()
    found = changed(Bundle(compiled_one), 3.0)
    assert found == changed.py_func(Bundle(plain), 3.0)
    assert found[0] == (True, False, True, False, True, True)
    np.testing.assert_array_equal(compiled_one.one.grid, plain.one.grid)
    assert compiled_one.record.tobytes() == plain.record.tobytes()
    assert plain.record[0]["a"] == 2**40


def test_the_layout_is_that_of_the_compiler():
    """A layout of another size would be read as other numbers, so it is refused."""
    assert Struct(layout_of(outer())[0]).size == len(Bundle(outer())._place)


class Named(NamedTuple):
    """A tuple whose field has the name of a bundle's attribute."""

    kind: int
    number: Any


def test_a_field_called_kind_does_not_hide_the_type_of_a_tuple():
    assert look_of(Named(1, 2.0)) != look_of(Named(1, 2))
    assert look_of(Named(1, 2.0)) == look_of(Named(3, 4.0))


def test_bundles_of_other_types_are_other_types_for_compiled_code():
    one, other = Bundle((np.zeros(2),)), Bundle((np.zeros(2, np.int64),))
    assert numba.typeof(one) == numba.typeof(Bundle((np.ones(5),)))
    assert numba.typeof(one) != numba.typeof(other)


@pytest.mark.parametrize("value", [("text",), (None,), ([1.0],), ({},)])
def test_what_is_no_number_is_refused(value: tuple[Any, ...]):
    with pytest.raises(TypeError, match="expected arrays, tuples and numbers, found a"):
        Bundle(value)


def test_code_for_bundles_of_our_types_is_kept_on_disk():
    """Without it every process would compile the flight again."""
    inner = numba.typeof((np.zeros(2), 1.0))
    assert _is_ours_throughout(BundleType(inner))
    assert not _is_ours_throughout(BundleType(numba.typeof(outer())))
