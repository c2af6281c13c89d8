"""Restores default values: the log omits fields that have their default."""

from types import UnionType
from typing import Any, Union, get_args, get_origin

import msgspec
from msgspec import NODEFAULT, Struct
from msgspec.structs import FieldInfo, asdict, fields

from testbed.core.types import EndingTick, HostTick, Tick

KINDS: dict[str, type[Struct]] = {  # by name of the schema
    "Tick": Tick, "EndingTick": EndingTick, "HostTick": HostTick,
}  # fmt: skip


def complete(kind: Any, message: Any) -> Any:
    """A message decoded from JSON with its omitted fields restored, except those that are None."""
    if isinstance(kind, type) and issubclass(kind, Struct) and isinstance(message, dict):
        known = {field.encode_name: field for field in fields(kind)}
        given = {k: complete(known[k].type, v) if k in known else v for k, v in message.items()}
        missing = {name: _default(f) for name, f in known.items() if name not in message}
        return given | {name: value for name, value in missing.items() if value is not None}
    origin, inner = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        return complete(_meant(inner, message), message)
    if origin is dict and isinstance(message, dict):
        return {key: complete(inner[1], value) for key, value in message.items()}
    return message


def _default(field: FieldInfo) -> Any:
    if field.default is NODEFAULT:
        return None
    if isinstance(field.default, Struct):
        return asdict(field.default)
    return msgspec.to_builtins(field.default)


def _meant(kinds: tuple[Any, ...], message: Any) -> Any:
    """The matching one of several kinds: the struct with the message's tag, or the only struct."""
    structs = [k for k in kinds if isinstance(k, type) and issubclass(k, Struct)]
    if isinstance(message, dict):
        for kind in structs:
            if kind.__struct_config__.tag in (message.get("type"), None):
                return kind
    return None
