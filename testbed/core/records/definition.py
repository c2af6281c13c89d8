"""Definition of a message: named fields with unit and meaning, read from a short text.

The text is that of a `.msg` file. The rules below make the bytes of a numpy record equal to CDR
(XCDR1, little endian), so a record is a ROS 2 message without any conversion:

* inside a message, fields stand in falling order of alignment: records and 8-byte numbers, then
  4, 2 and 1 byte; a message fills whole words of 8 bytes
* spare bytes are named `reserved`
* sequences come last, each after a `uint32` with the number of valid elements; their length in a
  record is a capacity, the same for all rows of a run
* text is in event messages only, which are no records
"""

import re
from enum import IntEnum
from typing import NamedTuple

import numpy as np

WORD = 8  # alignment of every message [bytes]
SCALARS = {
    "float64": "<f8", "uint64": "<u8", "int64": "<i8", "float32": "<f4", "uint32": "<u4",
    "int32": "<i4", "uint16": "<u2", "uint8": "u1", "byte": "u1", "bool": "?",
}  # fmt: skip
OURS = "testbed_msgs"  # the ROS 2 package of our messages

_LINE = re.compile(r"([\w/]+)(\[\d*\])? (\w+) *(?:# *(.*))?")
_CONSTANT = re.compile(r"\w+ [A-Z0-9_]+ *=.*")


class Field(NamedTuple):
    """One field of a message."""

    name: str
    kind: str  # a scalar, "string", or the name of a message
    length: int | None  # of an array; None: a single value
    sequence: bool  # of any length
    meaning: str  # with its unit in brackets

    @property
    def type_text(self) -> str:
        """The type as in a `.msg` file."""
        size = "[]" if self.sequence else "" if self.length is None else f"[{self.length}]"
        return f"{self.kind}{size}"


class Definition(NamedTuple):
    """One message."""

    name: str  # with its package, except ours
    meaning: str
    fields: tuple[Field, ...]
    codes: dict[str, type[IntEnum]]  # codes of a field

    @property
    def is_record(self) -> bool:
        """Whether it is a record: an event with text is not."""
        return self.name in DTYPES

    @property
    def fixed(self) -> tuple[Field, ...]:
        """Fields before the first sequence and its count."""
        first = next((k for k, one in enumerate(self.fields) if one.sequence), None)
        return self.fields if first is None else self.fields[: first - 1]

    @property
    def sequences(self) -> tuple[Field, ...]:
        """The sequences, each with a count before it."""
        return tuple(one for one in self.fields if one.sequence)


MESSAGES: dict[str, Definition] = {}  # by name, a message after those that it contains
DTYPES: dict[str, np.dtype] = {name: np.dtype(code) for name, code in SCALARS.items()}


def message(name: str, meaning: str, text: str, **codes: type[IntEnum]) -> np.dtype:
    """Define a message; returns the dtype of its fields before any sequence.

    Args:
        name: of its type.
        meaning: one sentence.
        text: lines of a `.msg` file, with the meaning of each field after `#`.
        codes: for a field that is a code, its meaning.

    Raises:
        ValueError: bytes of its records would differ from CDR.
    """
    found = parse(name, text, meaning, **codes)
    made = dtype_of(found, DTYPES)
    MESSAGES[name], DTYPES[name] = found, made
    return made


def text_message(name: str, meaning: str, text: str, **codes: type[IntEnum]) -> None:
    """Define a message with text in it, which is no record."""
    MESSAGES[name] = parse(name, text, meaning, **codes)


def parse(name: str, text: str, meaning: str = "", **codes: type[IntEnum]) -> Definition:
    """A definition from the text of a `.msg` file; constants in it are skipped.

    Raises:
        ValueError: a line is no field.
    """
    lines = [line.strip() for line in text.strip().splitlines()]
    kept = [one for one in lines if one and one[0] != "#" and not _CONSTANT.match(one)]
    return Definition(name, meaning, tuple(map(_field, kept)), codes)


def _field(line: str) -> Field:
    if (match := _LINE.fullmatch(line.strip())) is None:
        raise ValueError(f"expected `type name  # meaning`, found {line!r}")
    kind, size, name, meaning = match.groups(default="")
    length = int(size[1:-1]) if len(size) > 2 else None
    return Field(name, kind.removeprefix(f"{OURS}/"), length, size == "[]", meaning)


def dtype_of(found: Definition, known: dict[str, np.dtype]) -> np.dtype:
    """The dtype of the fields before any sequence; `known` are those of the messages in it.

    Raises:
        ValueError: its bytes would differ from CDR.
    """
    names, formats, offsets, at = [], [], [], 0
    for one in found.fixed:
        inner = known[one.kind]
        step = WORD if one.kind not in SCALARS else inner.itemsize
        if at % step:
            raise ValueError(f"{found.name}.{one.name}: {at % step} bytes before it need a name")
        names.append(one.name)
        formats.append(inner if one.length is None else (inner, (one.length,)))
        offsets.append(at)
        at += inner.itemsize * (one.length or 1)
    if at % WORD:
        raise ValueError(f"{found.name} ends at {at} bytes, expected a multiple of {WORD}")
    for k, one in enumerate(found.fields):
        if one.sequence and found.fields[k - 1].type_text != "uint32":
            raise ValueError(f"{found.name}.{one.name}: expected a uint32 before it, its count")
        if one.sequence and known[one.kind].itemsize % WORD:
            raise ValueError(f"{found.name}.{one.name}: expected elements of whole words")
    return np.dtype(
        {"names": names, "formats": formats, "offsets": offsets, "itemsize": at}, align=True
    )
