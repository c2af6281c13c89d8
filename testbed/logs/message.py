"""Messages as JSON, including NaN and infinite numbers.

JSON has no nan and no infinity, and msgspec writes null for them. The log must preserve them, so
they are written as the strings "nan", "inf" and "-inf", which a lenient reader accepts as floats. A
field that is None is omitted, because null does not fit a plain schema.
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
    """Encode a message as JSON; floats keep all bits."""
    data = _encode(message)
    if b"null" in data:  # a None, nan or infinity
        data = _encode(_spelled(msgspec.to_builtins(message)))
    return data


class Decoder(Generic[M]):
    """Decodes messages from `to_json`, also from older versions that wrote null."""

    def __init__(self, kind: type[M]) -> None:
        self._kind = kind
        self._decode = msgspec.json.Decoder(kind, strict=False).decode

    def decode(self, data: bytes) -> M:
        """One message.

        Raises:
            msgspec.DecodeError: it is not a message of this kind.
        """
        try:
            return self._decode(data)
        except msgspec.ValidationError:  # a None was omitted, or it is invalid
            tree = _with_nones(self._kind, msgspec.json.decode(data))
            return msgspec.convert(tree, self._kind, strict=False)


def from_json(data: bytes, kind: type[M]) -> M:
    """Decode one message from `to_json`."""
    return Decoder(kind).decode(data)


def _spelled(value: Any) -> Any:
    """The same tree without None, and with nan and infinity as strings."""
    match value:
        case float() if not math.isfinite(value):
            return str(value)
        case dict():
            return {name: _spelled(one) for name, one in value.items() if one is not None}
        case list() | tuple():
            return [_spelled(one) for one in value]
    return value


def _with_nones(kind: Any, tree: Any) -> Any:
    """The same tree with None in every missing field that may be None and has no default."""
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
