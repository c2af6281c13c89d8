"""Places of a message's parts in a row of bytes, for given capacities of its sequences.

A row is `[4 spare bytes][CDR header][fixed part][count, length, elements]...`. The spare bytes put
every number at a multiple of its size; the message is `row[4:]`.

Compiled code is compiled per type, and a numpy dtype with its capacities inside is a type per
fleet. `Rows.views` therefore has one array for the fixed part and one per sequence: their types do
not depend on capacities, so one compilation serves every fleet.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import messages  # noqa: F401  (fills MESSAGES)
from testbed.core.records.definition import DTYPES, MESSAGES, WORD, Definition, Field

Bytes = NDArray[np.uint8]
HEADER = b"\0\1\0\0"  # CDR, little endian
SPARE = WORD - len(HEADER)
COUNT = np.dtype([("valid", "<u4"), ("length", "<u4")])  # before the elements of a sequence


class Part(NamedTuple):
    """A sequence in a row."""

    field: Field
    offset: int  # of its COUNT, from the beginning of the row [bytes]
    capacity: int
    dtype: np.dtype


class Layout:
    """The layout of a message's rows.

    Args:
        name: of the message.
        capacities: most elements of each of its sequences; at least one is kept.
        dtypes: of all messages; other ones than ours for a log of another version.
        definition: of this message there.
    """

    def __init__(
        self, name: str, capacities: Mapping[str, int] | None = None,
        dtypes: Mapping[str, np.dtype] = DTYPES, definition: Definition | None = None,
    ) -> None:  # fmt: skip
        self.definition: Definition = definition or MESSAGES[name]
        self.fixed = dtypes[name]
        self.parts: list[Part] = []
        at = WORD + self.fixed.itemsize
        for one in self.definition.sequences:
            part = Part(one, at, max(1, (capacities or {})[one.name]), dtypes[one.kind])
            self.parts.append(part)
            at += COUNT.itemsize + part.capacity * part.dtype.itemsize
        self.pitch = at  # length of a row [bytes]
        self.size = at - SPARE  # of a message [bytes]

    def part(self, name: str) -> Part:
        """The sequence of this name."""
        return next(one for one in self.parts if one.field.name == name)

    def rows(self, number: int) -> "Rows":
        """Memory for so many empty rows; at least two, so that all views have the same type."""
        memory = np.zeros((max(2, number), self.pitch // WORD), np.uint64).view(np.uint8)
        memory[:, SPARE:WORD] = np.frombuffer(HEADER, np.uint8)
        rows = Rows(self, memory)
        for part in self.parts:
            rows.counts(part)["length"] = part.capacity
        return rows

    def dtype(self) -> np.dtype:
        """The dtype of a whole message, with its header: for `np.frombuffer`."""
        names, offsets = ["header"], [0]
        formats: list[Any] = [("u1", (len(HEADER),))]
        for name, (kind, at, *_) in (self.fixed.fields or {}).items():
            names.append(name)
            formats.append(kind)
            offsets.append(at + len(HEADER))
        for part in self.parts:
            name, at = part.field.name, part.offset - SPARE
            names += [f"{name}_valid", f"{name}_length", name]
            formats += ["<u4", "<u4", (part.dtype, (part.capacity,))]
            offsets += [at, at + 4, at + COUNT.itemsize]
        return np.dtype(
            {"names": names, "formats": formats, "offsets": offsets, "itemsize": self.size}
        )


class Rows:
    """Rows of one layout in memory."""

    def __init__(self, layout: Layout, memory: Bytes) -> None:
        self.layout, self.memory = layout, memory
        self.fixed = self._view(WORD, layout.fixed)

    def _view(self, at: int, dtype: np.dtype, capacity: int | None = None) -> NDArray[Any]:
        """An array of one `dtype` per row, or of `capacity` of them."""
        number, pitch = self.memory.shape
        shape = (number,) if capacity is None else (number, capacity)
        strides = (pitch,) if capacity is None else (pitch, dtype.itemsize)
        return np.ndarray(shape, dtype, self.memory, at, strides)

    def counts(self, part: Part) -> NDArray[Any]:
        """The number of valid elements and the length of a sequence in each row."""
        return self._view(part.offset, COUNT)

    def elements(self, part: Part) -> NDArray[Any]:
        """The elements of a sequence, shape (rows, capacity)."""
        return self._view(part.offset + COUNT.itemsize, part.dtype, part.capacity)

    def views(self, kind: type[Any]) -> Any:
        """The views for compiled code: a named tuple of `kind`, see views.py."""
        pairs = {part.field.name: part for part in self.layout.parts}
        found = {name: self.elements(part) for name, part in pairs.items()}
        found |= {f"{name}_count": self.counts(part)["valid"] for name, part in pairs.items()}
        return kind(fixed=self.fixed, **found)

    def message(self, k: int) -> bytes:
        """The bytes of row `k` as a CDR message."""
        return self.memory[k, SPARE:].tobytes()
