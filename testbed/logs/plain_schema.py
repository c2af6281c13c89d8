"""JSON Schemas that Foxglove reads.

Foxglove supports no references, choices or maps: every object must list its properties, every
property must have one plain type, every array one type of items (`parseJsonSchema` of its MCAP
support). So msgspec's schema of a struct is expanded:

* a field that may be None has its other type; the log omits fields that are None
* one of several structs is an object with the properties of all of them
* a map by vehicle is an object with a property for each vehicle
* other types are left out: lists of lists, such as camera samples
"""

from collections.abc import Iterable, Sequence
from typing import Any

import msgspec
from msgspec import Struct

Schema = dict[str, Any]

PLAIN = {"boolean", "integer", "number", "string"}


def plain_schema(kind: type[Struct], vehicles: Sequence[str] = ()) -> Schema:
    """The schema of a kind of message, in a log of these vehicles."""
    schema = msgspec.json.schema(kind)
    top = _plain(schema, schema.get("$defs", {}), vehicles)
    assert top is not None
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": kind.__name__} | top


def _plain(node: Schema, named: dict[str, Schema], vehicles: Sequence[str]) -> Schema | None:
    """The same schema without references, choices and maps; None: not possible."""
    if "$ref" in node:
        return _plain(named[node["$ref"].rpartition("/")[2]], named, vehicles)
    if "anyOf" in node:
        options = [_plain(one, named, vehicles) for one in node["anyOf"] if not _is_none(one)]
        return _either(options)
    if "enum" in node:
        codes = node["enum"]
        if all(isinstance(one, int) for one in codes):
            return {"type": "integer"}
        return {"type": "string", "enum": codes} if all(isinstance(w, str) for w in codes) else None
    kind = node.get("type")
    if kind in PLAIN:
        return {"type": kind}
    if kind == "array":
        items = _plain(node.get("items") or {}, named, vehicles)
        return None if items is None or items["type"] == "array" else _array(items)
    if kind == "object":
        return _object(node, named, vehicles)
    return None


def _is_none(node: Schema) -> bool:
    return node.get("type") == "null"


def _array(items: Schema) -> Schema:
    return {"type": "array", "items": items}


def _object(node: Schema, named: dict[str, Schema], vehicles: Sequence[str]) -> Schema | None:
    if isinstance(node.get("additionalProperties"), dict):
        inner = _plain(node["additionalProperties"], named, vehicles)
        return None if inner is None else _described(dict.fromkeys(vehicles, inner), ())
    given = node.get("properties", {})
    found = {name: _plain(one, named, vehicles) for name, one in given.items()}
    properties = {name: one for name, one in found.items() if one is not None}
    needed = [
        name for name in node.get("required", ())
        if name in properties and not any(map(_is_none, given[name].get("anyOf", ())))
    ]  # fmt: skip
    return _described(properties, needed)


def _described(properties: dict[str, Schema], needed: Iterable[str]) -> Schema:
    return {"type": "object", "properties": properties, "required": list(needed)}


def _either(options: list[Schema | None]) -> Schema | None:
    """One schema for several that are equal or all objects."""
    first, *others = options
    for one in others:
        first = None if first is None or one is None else _both(first, one)
    return first


def _both(a: Schema, b: Schema) -> Schema | None:
    if a["type"] != b["type"]:
        numbers = {a["type"], b["type"]} == {"integer", "number"}
        return {"type": "number"} if numbers else None
    if "enum" in a and "enum" in b:
        return {"type": "string", "enum": [*a["enum"], *b["enum"]]}
    if a["type"] != "object":
        return a if a == b else {"type": a["type"]} if a["type"] in PLAIN else None
    of_a, of_b = a["properties"], b["properties"]
    merged = {
        name: _both(of_a[name], of_b[name])
        if name in of_a and name in of_b
        else of_a.get(name) or of_b.get(name)
        for name in of_a | of_b
    }
    properties = {name: one for name, one in merged.items() if one is not None}
    needed = [name for name in a["required"] if name in b["required"] and name in properties]
    return _described(properties, needed)
