"""Generate the C header and the Python structs from messages.toml.

    python -m firmware_interface.generate

A test regenerates and compares them, so both sides always match messages.toml.
"""

import shutil
import subprocess
import sys
from pathlib import Path

from firmware_interface import published
from firmware_interface.schema import SOURCE, Enum, Field, Message, Schema, SchemaError, read

HERE = Path(__file__).parent
HEADER = HERE / "firmware/core/abt_messages.h"
MODULE = HERE / "messages.py"
NOTE = "Written by `python -m firmware_interface.generate` from messages.toml: change it there."


def header(schema: Schema) -> str:
    """Text of the C header `abt_messages.h`."""
    lines = [
        f"/* {NOTE} */",
        "#ifndef ABT_MESSAGES_H",
        "#define ABT_MESSAGES_H",
        "",
        "#include <stdbool.h>",
        "#include <stdint.h>",
        "",
        f"#define ABT_VERSION {schema.version}u",
        *(f"#define ABT_{name.upper()} {size}u" for name, size in schema.sizes.items()),
        f"#define ABT_PAYLOAD_MAX {max(m.size for m in schema.messages if m.code)}u",
        "",
        "static inline void abt_put_u8(uint8_t *at, uint8_t value) { at[0] = value; }",
        "static inline uint8_t abt_get_u8(const uint8_t *at) { return at[0]; }",
        "static inline void abt_put_u16(uint8_t *at, uint16_t value)",
        "{",
        "    at[0] = (uint8_t)value;",
        "    at[1] = (uint8_t)(value >> 8);",
        "}",
        "static inline uint16_t abt_get_u16(const uint8_t *at)",
        "{",
        "    return (uint16_t)(at[0] | (uint16_t)(at[1] << 8));",
        "}",
        "static inline void abt_put_u32(uint8_t *at, uint32_t value)",
        "{",
        "    abt_put_u16(at, (uint16_t)value);",
        "    abt_put_u16(at + 2, (uint16_t)(value >> 16));",
        "}",
        "static inline uint32_t abt_get_u32(const uint8_t *at)",
        "{",
        "    return abt_get_u16(at) | ((uint32_t)abt_get_u16(at + 2) << 16);",
        "}",
    ]
    for enum in schema.enums:
        lines += ["", f"/* {enum.doc} */", "typedef enum {"]
        for name, (code, meaning) in enum.names.items():
            lines.append(f"    ABT_{enum.name.upper()}_{name} = {code}, /* {meaning} */")
        lines.append(f"}} abt_{enum.name};")
    lines += ["", "typedef enum {"]
    lines += [f"    ABT_TYPE_{m.name.upper()} = {m.code}," for m in schema.messages if m.code]
    lines.append("} abt_type;")
    for message in schema.messages:
        lines += ["", *_c_message(message)]
    lines += ["", *_c_lengths(schema), "", "#endif", ""]
    return "\n".join(lines)


def _c_message(message: Message) -> list[str]:
    name = f"abt_{message.name}"
    size = f"ABT_{message.name.upper()}_SIZE"
    lines = [f"/* {message.doc} */", f"#define {size} {message.size}u"]
    if not message.fields:
        return lines
    lines += ["typedef struct {"]
    for f in message.fields:
        note = " ".join(filter(None, (f.meaning, f"[{f.unit}]" if f.unit else "")))
        array = f"[{f.count}]" if f.count else ""
        comment = f" /* {note} */" if note else ""
        lines.append(f"    uint{8 * f.width}_t {f.name}{array};{comment}")
    lines += [f"}} {name};", ""]
    lines += [f"static inline void {name}_pack(const {name} *from, uint8_t *to)", "{"]
    lines += _c_fields(message, "abt_put_u{bits}({to}, from->{name});")
    lines += ["}", f"static inline void {name}_unpack(const uint8_t *from, {name} *to)", "{"]
    lines += _c_fields(message, "to->{name} = abt_get_u{bits}({from_});")
    lines += ["}"]
    if any(f.least or f.most is not None for f in message.fields):
        lines += [f"static inline bool {name}_in_range(const {name} *it)", "{"]
        lines += ["    bool good = true;"]
        for f in message.fields:
            lines += _c_limits(f)
        lines += ["    return good;", "}"]
    return lines


def _c_fields(message: Message, pattern: str) -> list[str]:
    lines, at = [], 0
    for f in message.fields:
        step = f" + {f.width} * i" if f.count else ""
        line = pattern.format(
            bits=8 * f.width,
            name=f.name + ("[i]" if f.count else ""),
            to=f"to + {at}{step}",
            from_=f"from + {at}{step}",
        )
        if f.count:
            lines.append(f"    for (unsigned i = 0; i < {f.count}u; i++) {{")
            lines += [f"        {line}", "    }"]
        else:
            lines.append(f"    {line}")
        at += f.size
    return lines


def _c_limits(f: Field) -> list[str]:
    value = f"it->{f.name}" + ("[i]" if f.count else "")
    tests = [f"{value} >= {f.least}u"] if f.least else []
    tests += [f"{value} <= {f.most}u"] if f.most is not None else []
    if not tests:
        return []
    line = f"good = good && {' && '.join(tests)};"
    if not f.count:
        return [f"    {line}"]
    return [f"    for (unsigned i = 0; i < {f.count}u; i++) {{", f"        {line}", "    }"]


def _c_lengths(schema: Schema) -> list[str]:
    lines = [
        "#define ABT_NO_SUCH_TYPE 255u",
        "/* Payload length of what a host may send. */",
        "static inline uint8_t abt_payload_size(uint8_t type)",
        "{",
        "    switch (type) {",
    ]
    for m in schema.messages:
        if m.sender == "host":
            lines.append(f"    case ABT_TYPE_{m.name.upper()}: return ABT_{m.name.upper()}_SIZE;")
    return [*lines, "    default: return ABT_NO_SUCH_TYPE;", "    }", "}"]


def module(schema: Schema) -> str:
    """The Python module, before formatting."""
    lines = [
        '"""What host and board say to each other.',
        "",
        NOTE,
        '"""',
        "",
        "import struct",
        "from enum import IntEnum, IntFlag",
        "from typing import ClassVar",
        "",
        "from firmware_interface.packed import Packed",
        "",
        f"VERSION = {schema.version}",
        *(f"{name.upper()} = {size}" for name, size in schema.sizes.items()),
        f"PAYLOAD_MAX = {max(m.size for m in schema.messages if m.code)}",
        "",
    ]
    for enum in schema.enums:
        lines += ["", *_py_enum(enum)]
    for message in schema.messages:
        lines += ["", *_py_message(message)]
    known = [m for m in schema.messages if m.code]
    lines += [
        "",
        f"Message = {' | '.join(_camel(m.name) for m in known)}",
        "TYPES: dict[int, type[Message]] = {",
        *(f"    {m.code}: {_camel(m.name)}," for m in known),
        "}",
        "",
    ]
    return "\n".join(lines)


def _camel(name: str) -> str:
    return "".join(part.capitalize() for part in name.split("_"))


def _py_enum(enum: Enum) -> list[str]:
    lines = [f"class {_camel(enum.name)}({'IntFlag' if enum.flags else 'IntEnum'}):"]
    lines += [f'    """{enum.doc}"""', ""]
    return lines + [f"    {n} = {code}  # {why}" for n, (code, why) in enum.names.items()] + [""]


def _py_message(message: Message) -> list[str]:
    letter = {1: "B", 2: "H", 4: "I"}
    layout = "<" + "".join(f"{f.count or ''}{letter[f.width]}" for f in message.fields)
    lines = [f"class {_camel(message.name)}(Packed, frozen=True, gc=False):"]
    lines += [f'    """{message.doc}"""', ""]
    lines += [f"    CODE: ClassVar[int] = {message.code}"] if message.code else []
    lines += [f'    LAYOUT: ClassVar[struct.Struct] = struct.Struct("{layout}")']
    counts = "".join(f"{f.count}, " for f in message.fields)
    enums = "".join(f'"{f.name}": {_camel(f.enum)}, ' for f in message.fields if f.enum)
    lines += [f"    COUNTS: ClassVar[tuple[int, ...]] = ({counts.removesuffix(' ')})"]
    lines += [f"    ENUMS: ClassVar[dict[str, type]] = {{{enums.removesuffix(', ')}}}"]
    lines += ["    LIMITS: ClassVar[dict[str, tuple[int, int]]] = {"]
    for f in message.fields:
        if f.least or f.most is not None:
            most = f.most if f.most is not None else 256**f.width - 1
            lines.append(f'        "{f.name}": ({f.least or 0}, {most}),')
    lines += ["    }", ""]
    for f in message.fields:
        note = " ".join(filter(None, (f.meaning, f"[{f.unit}]" if f.unit else "")))
        kind = "tuple[int, ...]" if f.count else _camel(f.enum) if f.enum else "int"
        lines.append(f"    {f.name}: {kind}" + (f"  # {note}" if note else ""))
    return [*lines, ""]


def formatted(text: str) -> str:
    """`text` formatted by ruff, one of the development tools."""
    beside = Path(sys.executable).with_name("ruff")
    ruff = str(beside) if beside.exists() else shutil.which("ruff")
    if ruff is None:
        raise SchemaError("ruff is not installed; it comes with the extra `dev`")
    command = [ruff, "format", "-", "--stdin-filename", str(MODULE)]
    return subprocess.run(command, input=text, capture_output=True, text=True, check=True).stdout


def main() -> None:
    """Generate the C header and the Python module."""
    schema = read(SOURCE.read_text())
    published.check(schema)
    HEADER.write_text(header(schema))
    MODULE.write_text(formatted(module(schema)))


if __name__ == "__main__":
    main()
