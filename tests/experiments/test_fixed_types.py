"""Compiled functions that look at the types of their arguments once are handed the same always."""

import sys

import numba
import numpy as np
import pytest

from testbed.config import find, load
from testbed.core.compiled import compiled, with_fixed_types
from testbed.rig.observers import NullObserver
from testbed.rig.twin import make_twin

OURS = ("testbed.", "controllers.", "sim_twin.")


@compiled
def total(scale, rows):
    return scale * rows.sum()


def test_with_fixed_types_a_function_gives_what_the_function_gives():
    rows, own = np.arange(6.0).reshape(2, 3), with_fixed_types(total)
    for scale in (2.0, 0.1, 1.0 / 3.0):
        assert own(scale, rows) == total(scale, rows)


def test_a_fraction_where_a_whole_number_was_is_not_cut_off():
    rows, own = np.ones((2, 3)), with_fixed_types(total)
    assert [own(scale, rows) for scale in (2, 0.5, 3, 0.25)] == [12.0, 3.0, 18.0, 1.5]


@compiled
def first_of_each(pair):
    one, other = pair
    return 10.0 * one[0, 1] + other[0]


def test_owners_share_machine_code_only_for_what_looks_alike():
    grid, line = np.arange(6.0).reshape(2, 3), np.array([4.0, 5.0])
    frozen, whole = line.copy(), np.array([4, 5])
    frozen.flags.writeable = False
    for rows in (grid, np.asfortranarray(grid), grid[:, ::-1][:, ::-1], grid.astype(np.float32)):
        for column in (line, frozen, whole, np.arange(8.0)[4::2]):
            pair = (rows, column)
            assert with_fixed_types(first_of_each)(pair) == first_of_each.py_func(pair)
    with pytest.raises(TypeError, match="found a list"):
        with_fixed_types(first_of_each)((grid, [4.0]))


@pytest.mark.parametrize(
    ("name", "inject"),
    [
        ("zhang2023_table", ""),
        ("zhang2023_table_wrench", "{kind='drop_mocap', vehicle='sat2', at_s=1.0, for_s=0.3}"),
        ("gao2022_table", "{kind='lose_link', vehicle='sat2', at_s=1.0, value=0.7}"),
        ("xue2021_table_dynamic", "{kind='swap_bodies', vehicle='sat1', other='sat2', at_s=1.0}"),
    ],
)
def test_a_flight_never_hands_over_other_types(name, inject, monkeypatch):
    changed = []

    def watched(function):
        first = []

        def call(*args):
            kinds = tuple(map(numba.typeof, args))
            first.append(kinds)
            if kinds != first[0]:
                changed.append((function.__name__, first[0], kinds))
            return function(*args)

        return call

    ours = [m for name, m in sys.modules.items() if name.startswith(OURS)]
    for module in ours:
        if getattr(module, "with_fixed_types", None) is with_fixed_types:
            monkeypatch.setattr(module, "with_fixed_types", watched)
    flight = ["duration_s=2.0", "table.mocap.rate_hz=25.0", f"inject=[{inject}]"]
    make_twin(load(find(name), flight)).fly(NullObserver())
    assert changed == []
