"""What Foxglove takes for a JSON Schema, after its public documentation and its MCAP support.

The top is an object. Every object lists its properties. A property is a boolean, a number, a
string, an object, or an array whose items have one of these types, and an array is none. There are
no references, choices or lists of types. Nothing else of a schema is looked at.
"""

from typing import Any

SIMPLE = {"boolean", "integer", "number", "string"}
CHOICES = ("$ref", "anyOf", "allOf", "oneOf")
PYTHON = {"boolean": bool, "integer": int, "number": (int, float), "string": str}


def refused(schema: Any, path: str = "") -> list[str]:
    """Why the app would not open a topic of this schema; empty: it does."""
    if not isinstance(schema, dict) or schema.get("type") != "object":
        return [f"{path}: no object"]
    if not isinstance(schema.get("properties"), dict):
        return [f"{path}: an object without properties"]
    found = []
    for name, one in schema["properties"].items():
        here = f"{path}.{name}" if path else name
        items = one.get("items") if one.get("type") == "array" else None
        inner = one if items is None else items
        if any(word in one or word in inner for word in CHOICES):
            found.append(f"{here}: a reference or a choice")
        elif inner.get("type") == "object":
            found += refused(inner, here)
        elif not isinstance(inner.get("type"), str) or inner["type"] not in SIMPLE:
            found.append(f"{here}: type {inner.get('type')!r}")
    return found


def misfits(schema: dict[str, Any], message: Any, path: str = "") -> list[str]:
    """Where a message is not what its schema says, and what the schema does not name."""
    kind = schema["type"]
    if kind == "object":
        if not isinstance(message, dict):
            return [f"{path}: {message!r} is no object"]
        known = schema["properties"]
        found = [f"{path}.{name}: missing" for name in schema["required"] if name not in message]
        for name, value in message.items():
            here = f"{path}.{name}"
            found += misfits(known[name], value, here) if name in known else [f"{here}: unnamed"]
        return found
    if kind == "array":
        if not isinstance(message, list):
            return [f"{path}: {message!r} is no array"]
        return [
            w
            for k, one in enumerate(message)
            for w in misfits(schema["items"], one, f"{path}[{k}]")
        ]
    wrong = not isinstance(message, PYTHON[kind]) or (
        isinstance(message, bool) != (kind == "boolean")
    )
    if wrong or message not in schema.get("enum", [message]):
        return [f"{path}: {message!r} is no {kind}"]
    return []
