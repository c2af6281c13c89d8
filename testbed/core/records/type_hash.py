"""The hash of a message's definition by which ROS 2 compares types: RIHS01.

REP 2016 defines it: the SHA-256 of a JSON description of the type and of all types in it, without
constants and comments. Two computers that hash a type alike have the same fields in the same order.
"""

import json
from collections.abc import Iterator
from functools import cache
from hashlib import sha256
from typing import Any

from testbed.core.records import messages, standard  # noqa: F401  (fill MESSAGES)
from testbed.core.records.definition import MESSAGES, SCALARS, Definition, Field
from testbed.core.records.ros import ros_name

# of type_description_interfaces/msg/FieldType
NESTED = 1
CODES = {
    "int8": 2, "uint8": 3, "int16": 4, "uint16": 5, "int32": 6, "uint32": 7, "int64": 8,
    "uint64": 9, "float32": 10, "float64": 11, "bool": 15, "byte": 16, "string": 17,
}  # fmt: skip
ARRAY, SEQUENCE = 48, 144  # added to the code of the element


@cache
def type_hash(name: str) -> str:
    """The hash of a message, like `RIHS01_df668c74...`."""
    inside = sorted(set(_inside(name)), key=ros_name)
    description = {
        "type_description": _described(MESSAGES[name]),
        "referenced_type_descriptions": [_described(MESSAGES[one]) for one in inside],
    }
    return f"RIHS01_{sha256(json.dumps(description).encode()).hexdigest()}"


def _inside(name: str) -> Iterator[str]:
    """The messages in a message, and in those."""
    for one in MESSAGES[name].fields:
        if one.kind in MESSAGES:
            yield one.kind
            yield from _inside(one.kind)


def _described(definition: Definition) -> dict[str, Any]:
    return {"type_name": ros_name(definition.name), "fields": list(map(_field, definition.fields))}


def _field(field: Field) -> dict[str, Any]:
    is_basic = field.kind in SCALARS or field.kind == "string"
    code = CODES[field.kind] if is_basic else NESTED
    return {
        "name": field.name,
        "type": {
            "type_id": code + (SEQUENCE if field.sequence else ARRAY if field.length else 0),
            "capacity": field.length or 0,
            "string_capacity": 0,
            "nested_type_name": "" if is_basic else ros_name(field.kind),
        },
    }
