"""The columns of a log: per topic one numpy array of its rows, without parsing them.

`columns["/sat1/tick"]["outputs"]["state"]["pose"]["x"]` has one number per row. The definitions in
the log itself are used, so a log of another version has columns, too.
"""

from collections.abc import Mapping
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.records.definition import (
    DTYPES,
    MESSAGES,
    OURS,
    SCALARS,
    Definition,
    dtype_of,
    parse,
)
from testbed.core.records.layout import COUNT, HEADER, SPARE, Layout
from testbed.core.records.ros import LINE, schema_text
from testbed.logs.log_reader import LogError, LogReader

Rows = NDArray[Any]
_TOP = "top"  # name of a message whose schema is being read


class Columns:
    """The columns of a log; `texts` are the messages with text, in order."""

    def __init__(self, book: LogReader) -> None:
        data: dict[str, list[bytes]] = {}
        for topic, _, one in book.read():
            data.setdefault(topic, []).append(one)
        self.texts: dict[str, list[bytes]] = {}
        self.rows: dict[str, Rows] = {}
        for topic, rows in data.items():
            kind = book.kinds.get(topic, "")
            if "/" in kind:
                continue
            if kind in MESSAGES and not MESSAGES[kind].is_record:
                self.texts[topic] = rows
                continue
            try:
                self.rows[topic] = _stacked(shape_of(kind, book.texts.get(topic, "")), rows)
            except (ValueError, IndexError, KeyError) as error:
                raise LogError(f"{topic}: expected records of {kind}, found {error}") from None


class LoggedType:
    """A message as a log defines it."""

    def __init__(self, definition: Definition, dtypes: Mapping[str, np.dtype]) -> None:
        self.definition, self.dtypes = definition, dtypes

    def layout(self, capacities: Mapping[str, int]) -> Layout:
        """The layout of rows with these capacities."""
        return Layout(self.definition.name, capacities, self.dtypes, self.definition)

    def capacities(self, row: bytes) -> tuple[int, ...]:
        """Lengths of the sequences in a row."""
        at, found = len(HEADER) + self.dtypes[self.definition.name].itemsize, []
        for one in self.definition.sequences:
            found.append(int.from_bytes(row[at + 4 : at + 8], "little"))
            at += 8 + found[-1] * self.dtypes[one.kind].itemsize
        if at != len(row):
            raise ValueError(f"a row of {len(row)} bytes, not {at}")
        return tuple(found)


def shape_of(kind: str, text: str) -> LoggedType:
    """The shape of a message, from the text of its schema in the log; empty: ours."""
    if kind in DTYPES and text in ("", schema_text(kind)):
        return LoggedType(MESSAGES[kind], DTYPES)
    head, *others = text.split(f"{LINE}\n")
    named = {}
    for one in others:
        name, _, body = one.partition("\n")
        name = name.removeprefix("MSG: ").removeprefix(f"{OURS}/")
        named[name] = parse(name, body)
    named[_TOP] = parse(_TOP, head)
    dtypes = {name: np.dtype(code) for name, code in SCALARS.items()}

    def define(name: str) -> None:
        for one in named[name].fields:
            if one.kind not in dtypes:
                define(one.kind)
        dtypes[name] = dtype_of(named[name], dtypes)

    define(_TOP)
    return LoggedType(named[_TOP], dtypes)


def _stacked(shape: LoggedType, rows: list[bytes]) -> Rows:
    """All rows as one array, with the largest capacities among them."""
    names = [one.name for one in shape.definition.sequences]
    parts = [one for _, same in groupby(rows, len) for one in _alike(shape, list(same), names)]
    most = {n: max(part.capacities[k] for part in parts) for k, n in enumerate(names)}
    layout = shape.layout(most)
    if len(parts) == 1:
        return parts[0].data.view(layout.dtype())[:, 0]
    out, at = np.zeros((len(rows), layout.size), np.uint8), 0
    for part in parts:
        own, to = part.layout, out[at : at + len(part.data)]
        at += len(part.data)
        head = len(HEADER) + own.fixed.itemsize
        to[:, :head] = part.data[:, :head]
        for mine, there in zip(own.parts, layout.parts, strict=True):
            size = COUNT.itemsize + mine.capacity * mine.dtype.itemsize
            begin, end = mine.offset - SPARE, there.offset - SPARE
            to[:, end : end + size] = part.data[:, begin : begin + size]
    found = out.view(layout.dtype())[:, 0]
    for name, capacity in most.items():
        found[f"{name}_length"] = capacity
    return found


class RowBlock(NamedTuple):
    """Rows with the same capacities."""

    data: NDArray[np.uint8]  # (rows, bytes)
    capacities: tuple[int, ...]
    layout: Layout


def _alike(shape: LoggedType, rows: list[bytes], names: list[str]) -> list[RowBlock]:
    """Rows of one size; one part if they have the same capacities."""
    capacities = shape.capacities(rows[0])
    layout = shape.layout(dict(zip(names, capacities, strict=True)))
    if layout.size != len(rows[0]):
        raise ValueError("a sequence of length 0")
    data = np.frombuffer(b"".join(rows), np.uint8).reshape(len(rows), layout.size)
    found = data.view(layout.dtype())[:, 0]
    if all(np.all(found[f"{n}_length"] == k) for n, k in zip(names, capacities, strict=True)):
        return [RowBlock(data, capacities, layout)]
    return [one for row in rows for one in _alike(shape, [row], names)]
