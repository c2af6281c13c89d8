"""The contents of messages.toml as structs, from which `generate` writes both languages."""

import tomllib
from pathlib import Path

import msgspec
from msgspec import Struct

from testbed.core.error import TestbedError

SOURCE = Path(__file__).with_name("messages.toml")
WIDTH = {"u8": 1, "u16": 2, "u32": 4}


class SchemaError(TestbedError):
    """messages.toml contradicts itself."""


class Field(Struct, frozen=True):
    """One field of a message."""

    name: str
    width: int  # bytes of one element
    count: int  # elements; 0: not an array
    enum: str | None
    unit: str
    meaning: str
    least: int | None
    most: int | None

    @property
    def size(self) -> int:
        """Size of the field on the line [bytes]."""
        return self.width * max(1, self.count)


class Message(Struct, frozen=True):
    """A message, or a record that is only hashed (code 0)."""

    name: str
    code: int
    sender: str
    doc: str
    fields: tuple[Field, ...]

    @property
    def size(self) -> int:
        """Size of the payload [bytes]."""
        return sum(field.size for field in self.fields)


class Enum(Struct, frozen=True):
    """An enumeration or flags, with the name of each code."""

    name: str
    doc: str
    flags: bool
    names: dict[str, tuple[int, str]]


class Schema(Struct, frozen=True):
    """Contents of messages.toml."""

    version: int
    sizes: dict[str, int]  # of arrays
    enums: tuple[Enum, ...]
    messages: tuple[Message, ...]
    sealed: str  # see `published`

    @property
    def lines(self) -> tuple[str, ...]:
        """Everything that affects bytes on the line, without documentation."""
        lines = [f"{name} {size}" for name, size in self.sizes.items()]
        for enum in self.enums:
            lines += [f"{enum.name}.{name} {code}" for name, (code, _) in enum.names.items()]
        for message in self.messages:
            lines.append(f"{message.name} {message.code} {message.sender}")
            for f in message.fields:
                lines.append(
                    f"{message.name}.{f.name} {f.width} {f.count} {f.enum} {f.unit} {f.least}"
                    f" {f.most}"
                )
        return tuple(lines)


def read(text: str) -> Schema:
    """Parse messages.toml and check its names and sizes."""
    tree = tomllib.loads(text)
    sizes = {"valves": tree["valves"], "edges": tree["edges"]}
    enums = [
        Enum(name, body["doc"], kind == "flags", body["names"])
        for kind in ("enum", "flags")
        for name, body in tree[kind].items()
    ]
    names = {enum.name for enum in enums}
    messages = [
        Message(
            name,
            body.get("code", 0),
            body.get("from", "nobody"),
            body["doc"],
            tuple(_field(name, row, sizes, names) for row in body["fields"]),
        )
        for kind in ("message", "record")
        for name, body in tree[kind].items()
    ]
    codes = [message.code for message in messages if message.code]
    if len(set(codes)) < len(codes):
        raise SchemaError(f"{SOURCE.name}: two messages share a code: {sorted(codes)}")
    return Schema(tree["version"], sizes, tuple(enums), tuple(messages), tree["sealed"])


def _field(message: str, row: list, sizes: dict[str, int], enums: set[str]) -> Field:
    name, kind, unit, meaning, *limits = row
    kind, _, enum = kind.partition(":")
    kind, _, size = kind.partition("[")
    if kind not in WIDTH or (enum and enum not in enums) or (size and size[:-1] not in sizes):
        raise SchemaError(f"{SOURCE.name}: {message}.{name} has an unknown type: {row[1]!r}")
    bounds = msgspec.convert(limits[0] if limits else {}, dict[str, int])
    return Field(
        name,
        WIDTH[kind],
        sizes[size[:-1]] if size else 0,
        enum or None,
        unit,
        meaning,
        bounds.get("min"),
        bounds.get("max"),
    )
