"""Compiled code called by its address."""

from typing import NamedTuple

import numpy as np
import pytest
from numba.core import config

from testbed.core.bundle import Bundle, unpacked
from testbed.core.code_address import CodeAddress, call, called, same_kind
from testbed.core.compiled import compiled

if vars(config)["DISABLE_JIT"]:
    pytest.skip("there is no machine code", allow_module_level=True)


class Numbers(NamedTuple):
    """An array and a number."""

    values: np.ndarray
    scale: float


@compiled
def scaled(numbers, k, offset):
    it = unpacked(numbers)
    if k >= it.values.shape[0]:
        raise IndexError("no such value")
    it.values[k] = it.scale * it.values[k] + offset
    return it.values[k], k + 1


@compiled
def through(code, numbers, k):
    value, following = call(code, (numbers, k, 1))  # 1: becomes a float
    return value + following


@compiled
def sum_of_all(example, addresses):
    total = 0.0
    for k in range(addresses.shape[0]):
        total += unpacked(same_kind(example, addresses[k])).values.sum()
    return total


def numbers(*values, scale=2.0):
    return Bundle(Numbers(np.array(values), scale))


def test_the_code_gets_its_arguments_and_returns_its_results():
    one = numbers(1.0, 3.0)
    code = CodeAddress(scaled, (one, 0, 0.0))
    assert through(code, one, 1) == 7.0 + 2
    assert one.value.values.tolist() == [1.0, 7.0]
    assert through(code, other := numbers(5.0, scale=0.5), 0) == 3.5 + 1
    assert other.value.values.tolist() == [3.5]


@compiled
def through_called(code, one, k):
    return called(code, (one, k, 1.0))


@pytest.mark.parametrize("disabled", [False, True])
def test_called_runs_with_and_without_a_compiler(monkeypatch, disabled):
    monkeypatch.setitem(vars(config), "DISABLE_JIT", disabled)
    code = CodeAddress(scaled, (one := numbers(1.0, 3.0), 0, 0.0))
    direct = scaled(numbers(1.0, 3.0), 1, 1.0)
    found = through_called.py_func(code, one, 1) if disabled else through_called(code, one, 1)
    assert found == direct
    assert (int(code) == 0) == disabled


def test_an_exception_of_the_code_is_raised():
    one = numbers(1.0)
    code = CodeAddress(scaled, (one, 0, 0.0))
    with pytest.raises(IndexError, match="no such value"):
        through(code, one, 1)


def test_an_address_keeps_its_type():
    one = numbers(1.0)
    assert CodeAddress(scaled, (one, 0, 0.0)).kind == CodeAddress(scaled, (one, 5, 2.0)).kind
    assert CodeAddress(scaled, (one, 0, 0.0)).kind != CodeAddress(sum_of_all, (one, whole())).kind


def whole(*bundles):
    return np.array(bundles, np.int64)


def test_bundles_of_one_kind_are_found_by_their_addresses():
    several = [numbers(1.0, 2.0), numbers(10.0), numbers()]
    assert sum_of_all(several[0], whole(*several)) == 13.0
