"""Records: bytes equal to CDR, and one compilation for every fleet."""

import struct

import numba
import numpy as np
import pytest

from testbed.core.records import views
from testbed.core.records.definition import DTYPES, MESSAGES, SCALARS, Definition, message
from testbed.core.records.layout import HEADER, Layout

ROWS = {"Tick": views.TickRows, "HostTick": views.HostTickRows, "Truth": views.TruthRows}


def capacities(name: str, number: int) -> dict[str, int]:
    return {one.name: number + k for k, one in enumerate(MESSAGES[name].sequences)}


def rows_of(name: str, number: int):
    layout = Layout(name, capacities(name, number))
    rows = layout.rows(3)
    noise = np.random.default_rng(number)
    before = rows.memory.copy()
    rows.memory[:] = noise.integers(0, 256, rows.memory.shape, np.uint8)
    rows.memory[:, :8] = before[:, :8]
    for part in layout.parts:
        rows.counts(part)["length"] = part.capacity
    return rows


class Cdr:
    """Reads XCDR1 by its rules alone: a number is aligned to its size, nothing else is."""

    def __init__(self, data: bytes) -> None:
        assert data[:4] == HEADER
        self.data, self.at = data[4:], 0

    def number(self, code: str):
        size = np.dtype(code).itemsize
        self.at += -self.at % size
        value = np.frombuffer(self.data, code, 1, self.at)[0]
        self.at += size
        return value.tobytes()

    def read(self, definition: Definition) -> list:
        found = []
        for one in definition.fields:
            if one.sequence:
                count = struct.unpack("<I", self.number("<u4"))[0]
            else:
                count = 1 if one.length is None else one.length
            for _ in range(count):
                known = one.kind in SCALARS
                found += (
                    [self.number(SCALARS[one.kind])] if known else self.read(MESSAGES[one.kind])
                )
        return found


def flat(value, dtype: np.dtype) -> list:
    """The numbers of a numpy value, in order, without the lengths of sequences."""
    if dtype.subdtype is not None:
        return [x for one in value for x in flat(one, dtype.subdtype[0])]
    if dtype.names is None:
        return [value.tobytes()]
    lengths = {f"{n}_length" for n in dtype.names}
    names = [
        n for n in dtype.names if n != "header" and (n not in lengths or n == "inhibit_length")
    ]
    return [x for name in names for x in flat(value[name], dtype[name])]


@pytest.mark.parametrize("number", [0, 1, 4])
@pytest.mark.parametrize("name", sorted(set(MESSAGES) & set(DTYPES)))
def test_the_bytes_of_a_row_are_cdr(name: str, number: int) -> None:
    rows = rows_of(name, number)
    data = rows.message(2)
    cdr = Cdr(data)
    found = cdr.read(MESSAGES[name])
    dtype = rows.layout.dtype()
    assert cdr.at == len(data) - 4 == dtype.itemsize - 4
    assert found == flat(np.frombuffer(data, dtype)[0], dtype)


@pytest.mark.parametrize("name", sorted(ROWS))
def test_views_have_a_field_for_every_sequence(name: str) -> None:
    sequences = [one.name for one in MESSAGES[name].sequences]
    both = [n for one in sequences for n in (one, f"{one}_count")]
    assert list(ROWS[name]._fields) == ["fixed", *both]


@numba.njit
def ahead(state, h):
    state.pose.x += h * state.twist.vx


@numba.njit
def step(rows, k, h):
    fixed = rows.fixed[k]
    fixed.inputs.t += h
    ahead(fixed.outputs.state, h)
    for n in range(rows.neighbours_count[k]):
        ahead(rows.neighbours[k, n].state, h)
    for n in range(rows.samples_count[k]):
        rows.samples[k, n].x = fixed.inputs.t


def test_one_compilation_serves_every_fleet() -> None:
    for vehicles in (1, 3, 8):
        caps = capacities("Tick", 0) | {"neighbours": vehicles - 1, "samples": 4 * vehicles}
        rows = Layout("Tick", caps).rows(1)
        seen = rows.views(views.TickRows)
        seen.neighbours["state"]["twist"]["vx"] = 2.0
        seen.neighbours_count[:] = vehicles - 1
        seen.samples_count[:] = 4
        step(seen, 0, 0.5)
        read = np.frombuffer(rows.message(0), rows.layout.dtype())[0]
        assert read["inputs"]["t"] == 0.5
        assert read["samples"]["x"][:4].tolist() == [0.5] * 4
        assert read["neighbours"]["state"]["pose"]["x"].sum() == vehicles - 1
        assert seen.fixed.flags.aligned
    assert len(step.signatures) == 1


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("uint32 a", "multiple of 8"),
        ("uint32 a\nfloat64 b", "need a name"),
        ("float64[] a", "a uint32 before it"),
        ("uint32 a_valid\nuint32[] a", "whole words"),
        ("float64", "type name"),
    ],
)
def test_a_message_that_is_not_cdr_is_refused(text: str, expected: str) -> None:
    with pytest.raises(ValueError, match=expected):
        message("Wrong", "", text)
    MESSAGES.pop("Wrong", None)
