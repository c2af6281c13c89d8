"""Rows of numbers look like the structs that they stand for."""

import numpy as np
import pytest
from msgspec.structs import replace

from testbed.core.rows import SETPOINT_WIDTH, PoseSamples, References, is_finite, row_of_setpoint
from testbed.core.types import Accel, Demand, Pose, PoseSample, Reference, Trajectory, Twist
from testbed.logs.packing import getter

POSES = tuple(PoseSample(0.1 * k, 1.0 + k, 2.0 + k, 3.0) for k in range(4))
AHEAD = tuple(
    Reference(
        0.5 * k, Pose(k + 1.0, k + 2.0, k + 3.0), Twist(4.0, 5.0, 6.0), Accel(7.0, 8.0, 9.0 + k)
    )
    for k in range(3)
)
BOTH = pytest.mark.parametrize(
    ("kind", "structs"), [(PoseSamples, POSES), (References, AHEAD)], ids=["poses", "references"]
)


@BOTH
def test_every_struct_comes_back(kind, structs):
    rows = kind.of(structs)
    assert tuple(rows) == structs
    assert rows == structs
    assert structs == rows
    assert rows[-1] == structs[-1]
    assert rows[1:] == structs[1:]
    assert len(rows) == len(structs)
    assert rows.rows.shape == (len(structs), kind.width)
    assert repr(rows) == repr(structs)


@BOTH
def test_another_number_or_length_is_another_sequence(kind, structs):
    rows = kind.of(structs)
    assert rows != structs[:-1]
    assert rows != kind(rows.rows + 1e-12)
    assert rows != "poses"


@BOTH
def test_rows_are_not_converted_again(kind, structs):
    rows = kind.of(structs)
    assert kind.of(rows) is rows


@BOTH
def test_nothing_has_no_rows(kind, structs):
    assert kind.of(()).rows.shape == (0, kind.width)
    assert len(kind.of(())) == 0


@BOTH
def test_a_part_is_an_array_that_compiled_code_takes(kind, structs):
    part = kind.of(structs)[::2].rows
    assert part.flags.c_contiguous
    assert part.dtype == np.float64


@BOTH
def test_a_row_is_a_message_of_the_log(kind, structs):
    name = type(structs[0]).__name__
    assert kind.of(structs).rows[0].tolist() == list(getter(name)(structs[0]))


@pytest.mark.parametrize("column", range(References.width))
@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf")])
def test_every_number_of_the_newest_reference_must_be_finite(column, bad):
    row = row_of_setpoint(Trajectory(References.of(AHEAD), 9.0))
    assert is_finite(row)
    row[-References.width + column] = bad
    assert not is_finite(row)
    row[-References.width + column] = 0.0
    row[SETPOINT_WIDTH + 1] = bad  # an older one, which was checked when it was the newest
    assert is_finite(row)


@pytest.mark.parametrize("number", ["fx_w", "fy_w", "theta", "omega", "alpha"])
def test_every_number_of_a_demand_must_be_finite(number):
    demand = Demand(0.0, 1.0, 2.0, 0.1, 0.2, 0.3, 9.0)
    assert is_finite(row_of_setpoint(demand))
    assert not is_finite(row_of_setpoint(replace(demand, **{number: float("nan")})))
