"""Packs the fixed part and the sequences of a record from Python values, and unpacks them.

Used for rows that are made from structs. Compiled code writes its rows itself.
"""

import re
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from itertools import chain
from operator import attrgetter
from typing import Any, NamedTuple, TypeVar

from msgspec import Struct
from msgspec.structs import fields

from testbed.core.records.cdr import CODES
from testbed.core.records.definition import DTYPES, MESSAGES, SCALARS, Field
from testbed.core.records.layout import HEADER

S = TypeVar("S", bound=Struct)
_COUNT = struct.Struct("<II")  # of a sequence: valid elements, length
_PARTS: dict[type[Struct], tuple[type[Struct] | None, ...]] = {}


def form(kind: str) -> str:
    """The format of a record's fixed part for `struct`; spare bytes have no value."""
    return "".join(map(_form, MESSAGES[kind].fixed)) if kind in MESSAGES else CODES[kind]


def _form(field: Field) -> str:
    number = field.length or 1
    if field.name == "reserved":
        return f"{DTYPES[field.kind].itemsize * number}x"
    return form(field.kind) * number


@cache
def several(kind: str, number: int) -> struct.Struct:
    """Packs the numbers of so many elements."""
    return struct.Struct("<" + form(kind) * number)


def leaves(kind: str, prefix: str = "") -> Iterator[str]:
    """Dotted names of all numbers in a record."""
    for one in MESSAGES[kind].fixed:
        if one.kind in SCALARS and one.name != "reserved":
            several = "" if one.length is None else [f"[{k}]" for k in range(one.length)]
            yield from (f"{prefix}{one.name}{k}" for k in several or [""])
        elif one.kind in MESSAGES:
            yield from leaves(one.kind, f"{prefix}{one.name}.")


def only(kind: str, *names: str) -> struct.Struct:
    """Unpacks only these numbers from the bytes of a record, with its header; in its order."""
    codes, name = ["4x"], leaves(kind)
    for code in re.findall(r"\d+x|[^\dx]", form(kind)):
        is_spare = code.endswith("x")
        kept = is_spare or next(name) in names
        codes.append(code if kept else f"{struct.calcsize(code)}x")
    return struct.Struct("<" + "".join(codes))


def getter(kind: str) -> Callable[[Any], tuple[Any, ...]]:
    """All numbers of a struct with the fields of a message, in order."""
    return attrgetter(*leaves(kind))


def elements(kind: str, rows: Iterable[Any]) -> tuple[int, bytes]:
    """Number and bytes of the elements of a sequence."""
    found = list(rows)
    return len(found), several(kind, len(found)).pack(*chain.from_iterable(found))


def packed(name: str, fixed: Sequence[Any], *sequences: tuple[int, bytes]) -> bytes:
    """One message without spare elements, see `Packer.pack`."""
    parts = [HEADER, several(name, 1).pack(*fixed)]
    for number, data in sequences:
        parts += (_COUNT.pack(number, number), data)
    return b"".join(parts)


def made(kind: type[S], numbers: Iterator[Any]) -> S:
    """A struct from the next numbers, the inverse of `getter`."""
    if kind not in _PARTS:
        _PARTS[kind] = tuple(
            one.type if issubclass(one.type, Struct) else None for one in fields(kind)
        )
    parts = (next(numbers) if one is None else made(one, numbers) for one in _PARTS[kind])
    return kind(*parts)


class Unpacked(NamedTuple):
    """The numbers of a record."""

    fixed: tuple[Any, ...]
    sequences: dict[str, list[tuple[Any, ...]]]  # elements by name of the sequence


@cache
def whole(kind: str, most: tuple[int, ...]) -> struct.Struct:
    """Packs a message with sequences of these capacities; shorter ones are filled with 0."""
    sizes = (DTYPES[one.kind].itemsize for one in MESSAGES[kind].sequences)
    sequences = (f"II{number * size}s" for number, size in zip(most, sizes, strict=True))
    return struct.Struct(f"<4s{form(kind)}{''.join(sequences)}")


class Packer:
    """Packs messages of one topic; capacities grow to the longest sequence so far."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.most = [1] * len(MESSAGES[name].sequences)  # capacities

    def grow(self, most: list[int]) -> None:
        """Take these capacities, none of them smaller than before."""
        self.most = most

    def pack(self, fixed: Iterable[Any], sequences: Iterable[tuple[int, bytes]]) -> bytes:
        """Encode one message as CDR.

        Args:
            fixed: numbers of the fixed part.
            sequences: for each, the number of its elements and their bytes.
        """
        most = list(self.most)
        parts: list[Any] = []
        for k, (number, data) in enumerate(sequences):
            most[k] = max(most[k], number)
            parts += (number, most[k], data)
        self.grow(most)
        return whole(self.name, tuple(most)).pack(HEADER, *fixed, *parts)


def unpack(name: str, data: bytes) -> Unpacked:
    """The numbers of a message.

    Raises:
        ValueError: it is no such message.
    """
    head = several(name, 1)
    at = len(HEADER) + head.size
    found: dict[str, list[tuple[Any, ...]]] = {}
    try:
        fixed = head.unpack_from(data, len(HEADER))
        for one in MESSAGES[name].sequences:
            valid, length = _COUNT.unpack_from(data, at)
            begin, size = at + _COUNT.size, DTYPES[one.kind].itemsize
            at = begin + length * size
            if valid > length or at > len(data):
                raise ValueError(f"{one.name} of {valid} in {length} elements")
            elements = data[begin : begin + valid * size]
            found[one.name] = list(several(one.kind, 1).iter_unpack(elements))
    except struct.error as error:
        raise ValueError(f"expected a {name}, found {error}") from None
    if at != len(data) or data[:4] != HEADER:
        raise ValueError(f"expected a {name} of {at} bytes, found {len(data)}")
    return Unpacked(fixed, found)
