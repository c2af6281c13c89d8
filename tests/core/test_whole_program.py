"""Compiled functions that call each other: linked whole, for our own entries and for others'."""

import sys

import numba
import numpy as np
import pytest
from llvmlite.binding import parse_bitcode
from numba.core.codegen import JITCodeLibrary
from numba.core.runtime import rtsys
from numba.core.runtime._nrt_python import memsys_enable_stats
from numba.extending import overload

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


@compiled
def turned_round(x, times):
    """Makes and drops an array each time; the last one is returned, or `x` itself."""
    kept = x
    for _ in range(times):
        kept = kept[::-1] + 0.0
    return kept[1:]


@compiled
def chosen(x, k, doubled):
    return 2.0 * x[k] if doubled else x[k]


@compiled
def chooses(x):
    several = 0.0
    for k in range(2):
        several += chosen(x, k, k == 1)
    return several + chosen(x, 1, True) + chosen(x, k=2, doubled=False)


@numba.njit
def of_a_user(x):
    return both(x)


@compiled
def refuses(x):
    raise ValueError(f"expected three numbers, found {len(x)}")


@compiled
def asks(x):
    refuses(x)
    return x


@numba.njit
def of_a_user_that_writes(rows, x):
    rows[:2] = x
    return rows


@compiled
def writes(rows, x):
    rows[:2] = x
    return rows


def doubled(x):
    return 2.0 * x


@overload(doubled)
def _doubled(x):
    return lambda x: np.full(3, 2.0) * x


@compiled
def with_overload(x):
    return doubled(x)


@numba.njit
def of_a_user_with_overload(x):
    return doubled(x) + with_overload(x)


X = np.array([2.0, 5.0, 0.25])


@pytest.mark.parametrize("way", [both, of_a_user])
def test_what_calls_many_parts_gives_what_plain_python_gives(way):
    assert way(X) == both.py_func(X)


def test_no_machine_code_is_made_of_a_part():
    both(X)
    part = next(iter(innermost.part.overloads.values()))
    assert part.library.get_pointer_to_function(part.fndesc.llvm_func_name) == 0


def test_a_part_is_lowered_once_whatever_its_constants():
    assert chooses(X) == chooses.py_func(X)
    assert len(chosen.part.overloads) == 1


def test_overloads_are_parts(monkeypatch):
    finished, finalize = [], JITCodeLibrary.finalize

    def recorded(library):
        finished.append((library.name, type(library).__name__))
        finalize(library)

    monkeypatch.setattr(JITCodeLibrary, "finalize", recorded)
    assert with_overload(X).tolist() == (2.0 * X).tolist()
    assert of_a_user_with_overload(X).tolist() == (4.0 * X).tolist()
    names = [name for name, kind in finished if kind != "PartLibrary"]
    assert {"with_overload", "of_a_user_with_overload"} <= set(names)
    assert not [name for name in names if "doubled" in name or "full" in name]


def test_machine_code_is_kept_with_its_names_and_without_its_source():
    """To read that source took most of the time to load an entry."""
    both(X)
    (one,) = both.overloads.values()
    _, _, (code, names) = one.library.serialize_using_object_code()
    assert code[:4] in (b"\x7fELF", b"\xcf\xfa\xed\xfe")  # Linux, macOS
    found = {f.name: [str(line).strip() for b in f.blocks for line in b.instructions]
             for f in parse_bitcode(names).functions}  # fmt: skip
    assert found[one.fndesc.llvm_func_name] == ["ret void"]
    assert found[one.fndesc.llvm_cpython_wrapper_name] == ["ret void"]


def test_an_error_deep_inside_reaches_the_caller():
    for way in (both, of_a_user):
        with pytest.raises(ValueError, match="expected a positive number"):
            way(-X)
    with pytest.raises(ValueError, match="expected three numbers, found 2"):
        asks(X[:2])
    for way in (of_a_user_that_writes, writes):
        with pytest.raises(ValueError, match="cannot assign an array to a slice of another"):
            way(np.zeros(3), X)


def test_a_function_is_called_from_python_and_from_compiled_code():
    assert (innermost(X), left(X)) == (6.0, 6.0 + 7.25 + 1.0)


def test_owners_of_arrays_are_counted_without_calls():
    turned_round(X, 1)
    (code,) = [one.library.get_llvm_str() for one in turned_round.overloads.values()]
    assert "NRT_MemInfo_alloc" in code
    assert "call void @NRT_incref" not in code
    assert "call void @NRT_decref" not in code


@pytest.mark.parametrize("times", [0, 1, 2, 7])
def test_an_array_lives_as_long_as_its_owners(times):
    memsys_enable_stats()
    x = X.copy()
    turned_round(x, times)
    before, owners = rtsys.get_allocation_stats(), sys.getrefcount(x)
    found = turned_round(x, times)
    assert found.tolist() == (x[::-1] if times % 2 else x)[1:].tolist()
    made = rtsys.get_allocation_stats()
    assert made.alloc - before.alloc >= times
    assert made.mi_alloc - made.mi_free - (before.mi_alloc - before.mi_free) == 1  # `found` lives
    assert sys.getrefcount(x) == owners + (times == 0)
    del found
    after = rtsys.get_allocation_stats()
    assert after.mi_alloc - after.mi_free == before.mi_alloc - before.mi_free
    assert sys.getrefcount(x) == owners
