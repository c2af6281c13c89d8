"""Messages as JSON, also those in which a number is none.

JSON has no nan and no infinity, and msgspec writes null for them. A log that ends in one must be
read again all the same, so they are written as the strings "nan", "inf" and "-inf", which a reader
that is not strict takes for floats.
"""

import math
from typing import Any, TypeVar

import msgspec
from msgspec import Struct

M = TypeVar("M", bound=Struct)

_encode = msgspec.json.Encoder().encode


def to_json(message: Struct) -> bytes:
    """The message as JSON, every float with all its bits."""
    data = _encode(message)
    if b"null" in data:  # a None, or a number that is none
        data = _encode(_spelled(msgspec.to_builtins(message)))
    return data


def from_json(data: bytes, kind: type[M]) -> M:
    """A message that `to_json` wrote."""
    return msgspec.json.decode(data, type=kind, strict=False)


def _spelled(value: Any) -> Any:
    """The same tree with floats that are no numbers as strings."""
    match value:
        case float() if not math.isfinite(value):
            return str(value)
        case dict():
            return {name: _spelled(one) for name, one in value.items()}
        case list() | tuple():
            return [_spelled(one) for one in value]
    return value
