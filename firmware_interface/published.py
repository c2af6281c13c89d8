"""Published versions of the messages: written once and never changed.

    python -m firmware_interface.published

writes golden/version_<n>.json for the `version` in messages.toml: every field, code and limit as
text, and golden frames. Boards in the field use these versions. Each file contains the hash of the
previous one and messages.toml that of the newest (`sealed`), so every change is detected; in git
each file may only have been added.
"""

import hashlib
import json
from collections.abc import Iterator
from difflib import ndiff
from pathlib import Path

from firmware_interface.compiler import FIRMWARE
from firmware_interface.frame import Frame, encode
from firmware_interface.schema import SOURCE, Field, Message, Schema, SchemaError, read

GOLDEN = FIRMWARE / "golden"
HINT = "Boards in the field speak the old one: raise `version` in messages.toml and publish it."


def path_of(version: int, folder: Path = GOLDEN) -> Path:
    """Path of a published version."""
    return folder / f"version_{version}.json"


def seal(version: int, folder: Path = GOLDEN) -> str:
    """Hash of a published version's file; empty for version 0.

    Raises:
        SchemaError: the file does not exist.
    """
    if version == 0:
        return ""
    path = path_of(version, folder)
    if not path.exists():
        raise SchemaError(
            f"version {version} of the messages is not published ({path.name} is missing): if its"
            " fields are final, run `python -m firmware_interface.published`"
        )
    return hashlib.sha256(path.read_bytes()).hexdigest()


def check(schema: Schema, folder: Path = GOLDEN) -> None:
    """Reject messages that differ from the published version, and edited published files.

    Raises:
        SchemaError: names the difference and what to do.
    """
    expected = schema.sealed
    for version in range(schema.version, 0, -1):
        if seal(version, folder) != expected:
            raise SchemaError(
                f"{path_of(version, folder).name} differs from what was published (its hash is not"
                f" {expected[:12]}...): restore it. {HINT}"
            )
        expected = json.loads(path_of(version, folder).read_text())["before"]
    was = json.loads(path_of(schema.version, folder).read_text())["schema"]
    if was != list(schema.lines):
        changed = [line for line in ndiff(was, schema.lines) if line[0] in "+-"]
        raise SchemaError(
            f"{SOURCE.name} differs from version {schema.version} as published: {changed}. {HINT}"
        )


def frames(schema: Schema) -> Iterator[dict]:
    """Golden frames: each message with minimum, maximum and irregular values."""
    known = [message for message in schema.messages if message.code]
    for number, message in enumerate(m for m in known for _ in range(3)):
        fields = {f.name: _value(schema, f, number % 3, at) for at, f in enumerate(message.fields)}
        seq, t_us = (number * 9973) & 0xFFFF, (number * 0x3C6EF372) & 0xFFFFFFFF
        payload = _bytes(message, fields)
        coded = encode(Frame(message.code, seq, t_us, payload, schema.version))
        name = "".join(part.capitalize() for part in message.name.split("_"))
        yield {
            "message": name, "version": schema.version, "seq": seq, "t_us": t_us,
            "hex": coded.hex(), "fields": fields,
        }  # fmt: skip


def _value(schema: Schema, f: Field, sort: int, at: int) -> int | list[int]:
    codes = [code for e in schema.enums if e.name == f.enum for code, _ in e.names.values()]
    least = f.least or 0
    most = f.most if f.most is not None else 256**f.width - 1

    def one(element: int) -> int:
        if codes:
            return codes[(0, -1, at % len(codes))[sort]]
        middle = least + (0x9E3779B9 * (at + 7 * element + 1)) % (most - least + 1)
        return (least, most, middle)[sort]

    return [one(element) for element in range(f.count)] if f.count else one(0)


def _bytes(message: Message, fields: dict[str, int | list[int]]) -> bytes:
    found = b""
    for f in message.fields:
        value = fields[f.name]
        for one in value if isinstance(value, list) else [value]:
            found += one.to_bytes(f.width, "little")
    return found


def publish(schema: Schema, folder: Path = GOLDEN) -> str:
    """Write a version's file; returns the value for `sealed` in messages.toml.

    Raises:
        SchemaError: the version is already published.
    """
    path = path_of(schema.version, folder)
    if path.exists():
        raise SchemaError(f"version {schema.version} is already published. {HINT}")
    before = seal(schema.version - 1, folder)
    parts = {
        "version": f"{schema.version}",
        "before": json.dumps(before),
        "schema": _rows(schema.lines),
        "frames": _rows(frames(schema)),
    }
    body = ",\n".join(f'"{name}": {text}' for name, text in parts.items())
    path.write_text(f"{{\n{body}\n}}\n")
    return seal(schema.version, folder)


def _rows(values: object) -> str:
    assert isinstance(values, tuple | Iterator)
    return "[\n" + ",\n".join(json.dumps(value) for value in values) + "\n]"


if __name__ == "__main__":
    print(f'sealed = "{publish(read(SOURCE.read_text()))}"')  # noqa: T201
