"""Any message to and from CDR (XCDR1, little endian), with text: for events and standard messages.

A message is a dict of its fields; a list stands for an array or a sequence. Rows need none of it.
"""

import struct
from typing import Any

from testbed.core.records.definition import MESSAGES, SCALARS, Definition
from testbed.core.records.layout import HEADER

CODES = {
    "float64": "d", "uint64": "Q", "int64": "q", "float32": "f", "uint32": "I", "int32": "i",
    "uint16": "H", "uint8": "B", "byte": "B", "bool": "?",
}  # fmt: skip
Message = dict[str, Any]


class CdrError(ValueError):
    """Bytes that are not such a message."""


def encode(name: str, message: Message) -> bytes:
    """The bytes of a message; a field that is left out is zero or empty."""
    return Form(name, message).encoded()


class Form:
    """The layout of a message; others that differ only in their numbers are packed quickly.

    Args:
        name: of a message in MESSAGES.
        message: its fields; one that is left out is zero or empty.
    """

    def __init__(self, name: str, message: Message) -> None:
        self._format, self._size = ["<4s"], 0  # size: without the header
        self._parts: list[Any] = [HEADER]  # numbers and texts, in order
        self._numbers: list[int] = []  # which of these are numbers of the message
        self._add(MESSAGES[name], message)
        self._struct = struct.Struct("".join(self._format))

    def encoded(self) -> bytes:
        """The bytes of the message."""
        return self._struct.pack(*self._parts)

    def pack(self, *numbers: float) -> bytes:
        """The bytes of the message with all its numbers replaced, in the order of its fields."""
        for k, number in zip(self._numbers, numbers, strict=True):
            self._parts[k] = number
        return self._struct.pack(*self._parts)

    def _add(self, definition: Definition, message: Message) -> None:
        for one in definition.fields:
            value = message.get(one.name)
            if one.sequence:
                self._put("I", len(value or ()))
            several = one.sequence or one.length is not None
            values = (value or [None] * (one.length or 0)) if several else [value]
            if one.kind in SCALARS:
                for number in values:
                    self._numbers.append(len(self._parts))
                    self._put(CODES[one.kind], number or 0)
            elif one.kind == "string":
                for text in values:
                    data = (text or "").encode(errors="backslashreplace") + b"\0"
                    self._put("I", len(data))
                    self._put(f"{len(data)}s", data, align=1)
            elif one.kind in MESSAGES:
                for inner in values:
                    self._add(MESSAGES[one.kind], inner or {})

    def _put(self, code: str, value: Any, align: int = 0) -> None:
        size = struct.calcsize(code)
        spare = -self._size % (align or size)
        self._format.append(f"{spare}x{code}" if spare else code)
        self._size += spare + size
        self._parts.append(value)


def decode(definition: Definition, data: bytes, known: dict[str, Definition] = MESSAGES) -> Message:
    """The message in some bytes.

    Args:
        definition: of the message.
        data: with the CDR header.
        known: the messages in it.

    Raises:
        CdrError: it is no such message.
    """
    if data[:4] != HEADER:
        raise CdrError(f"expected CDR, little endian, found a message that begins {data[:4]!r}")
    try:
        return _Reader(data[4:], known).message(definition)
    except (struct.error, UnicodeDecodeError, KeyError) as error:
        raise CdrError(f"expected a {definition.name}, found {error}") from None


class _Reader:
    def __init__(self, data: bytes, known: dict[str, Definition]) -> None:
        self._data, self._at, self._known = data, 0, known

    def message(self, definition: Definition) -> Message:
        found: Message = {}
        for one in definition.fields:
            number = one.length
            if one.sequence:
                number = self._numbers("I", 1)[0]
                if number > len(self._data):  # an element has a byte or more
                    raise CdrError(f"{one.name} of {number} elements in {len(self._data)} bytes")
            values = self._values(one.kind, 1 if number is None else number)
            found[one.name] = values[0] if number is None else values
        return found

    def _values(self, kind: str, number: int) -> list[Any]:
        if kind in SCALARS:
            return self._numbers(CODES[kind], number)
        if kind == "string":
            return [self._text() for _ in range(number)]
        return [self.message(self._known[kind]) for _ in range(number)]

    def _numbers(self, code: str, number: int) -> list[Any]:
        if number == 0:
            return []
        self._at += -self._at % struct.calcsize(code)
        form = struct.Struct(f"<{number}{code}")
        values = form.unpack_from(self._data, self._at)
        self._at += form.size
        return list(values)

    def _text(self) -> str:
        length = self._numbers("I", 1)[0]
        data = self._data[self._at : self._at + length]
        if len(data) < length or not length:
            raise CdrError("a text is longer than its message")
        self._at += length
        return data[:-1].decode()
