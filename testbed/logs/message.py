"""Messages as JSON, also those in which a number is none.

JSON has no nan and no infinity, and msgspec writes null for them. A log that ends in one must be
read again all the same, so they are written as the strings "nan", "inf" and "-inf", which a reader
that is not strict takes for floats. A field that is None is left out: a null fits no plain schema.
"""

import math
from types import NoneType
from typing import Any, Generic, TypeVar, get_args

import msgspec
from msgspec import Struct
from msgspec.structs import fields

M = TypeVar("M", bound=Struct)

_encode = msgspec.json.Encoder().encode


def to_json(message: Struct) -> bytes:
    """The message as JSON, every float with all its bits."""
    data = _encode(message)
    if b"null" in data:  # a None, or a number that is none
        data = _encode(_spelled(msgspec.to_builtins(message)))
    return data


class Decoder(Generic[M]):
    """Reads messages of a kind that `to_json` wrote, now or in older versions with their nulls."""

    def __init__(self, kind: type[M]) -> None:
        self._kind = kind
        self._decode = msgspec.json.Decoder(kind, strict=False).decode

    def decode(self, data: bytes) -> M:
        """One message.

        Raises:
            msgspec.DecodeError: it is something else.
        """
        try:
            return self._decode(data)
        except msgspec.ValidationError:  # a None is missing, or it is something else
            tree = _with_nones(self._kind, msgspec.json.decode(data))
            return msgspec.convert(tree, self._kind, strict=False)


def from_json(data: bytes, kind: type[M]) -> M:
    """A message that `to_json` wrote."""
    return Decoder(kind).decode(data)


def _spelled(value: Any) -> Any:
    """The same tree without None, and with floats that are no numbers as strings."""
    match value:
        case float() if not math.isfinite(value):
            return str(value)
        case dict():
            return {name: _spelled(one) for name, one in value.items() if one is not None}
        case list() | tuple():
            return [_spelled(one) for one in value]
    return value


def _with_nones(kind: Any, tree: Any) -> Any:
    """The same tree with None where a field that may be None, and has no default, is missing."""
    if not (isinstance(kind, type) and issubclass(kind, Struct) and isinstance(tree, dict)):
        return tree
    found = dict(tree)
    for field in fields(kind):
        name = field.encode_name
        if name in found:
            found[name] = _with_nones(field.type, found[name])
        elif field.required and NoneType in get_args(field.type):
            found[name] = None
    return found
