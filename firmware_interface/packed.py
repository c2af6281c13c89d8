"""Base of the generated message structs in `messages`: packing and unpacking."""

import struct
from typing import Any, ClassVar, Self

from msgspec import Struct


class Packed(Struct, frozen=True, gc=False):
    """A message; its fields have the order of the bytes on the line."""

    LAYOUT: ClassVar[struct.Struct]
    COUNTS: ClassVar[tuple[int, ...]]  # elements of each field; 0: not an array
    ENUMS: ClassVar[dict[str, Any]]  # fields with named codes
    LIMITS: ClassVar[dict[str, tuple[int, int]]]

    def pack(self) -> bytes:
        """The payload as bytes."""
        values: list[int] = []
        for name, count in zip(self.__struct_fields__, self.COUNTS, strict=True):
            value = getattr(self, name)
            values += value if count else (value,)
        return self.LAYOUT.pack(*values)

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        """Decode a payload; struct.error or ValueError if it is invalid."""
        found = cls.LAYOUT.unpack(payload)
        values: list[Any] = []
        at = 0
        for name, count in zip(cls.__struct_fields__, cls.COUNTS, strict=True):
            one = found[at : at + count] if count else found[at]
            values.append(cls.ENUMS[name](one) if name in cls.ENUMS else one)
            at += count or 1
        return cls(*values)
