"""What Foxglove and PlotJuggler take for a ros2msg schema, after their public parsers.

Foxglove: a schema is definitions between lines of `=`, each but the first after a line
`MSG: package/Name`. A line is a comment, or a type, white space and a name, then perhaps `=` and a
constant, or a comment. A field's name is in lower case without double underscores, a constant's in
upper case, and its value is in the range of its type. A type that is not built in is defined in the
schema, by its whole name. PlotJuggler: the same, with one `/` at most in a type, and it leaves out
arrays longer than LONGEST.
"""

import re

BUILT_IN = {
    "bool": 1, "byte": 8, "char": 8, "float32": 0, "float64": 0, "int8": 7, "uint8": 8, "int16": 15,
    "uint16": 16, "int32": 31, "uint32": 32, "int64": 63, "uint64": 64, "string": 0, "wstring": 0,
}  # fmt: skip
LINE = re.compile(r"([a-zA-Z0-9_/]+)(\[\d*\])?\s+([a-zA-Z0-9_]+)\s*(=\s*[^#]*)?(#.*)?")
FIELD, CONSTANT = re.compile(r"[a-z](_?[a-z0-9]+)*"), re.compile(r"[A-Z](_?[A-Z0-9]+)*")
LONGEST = 100


def refused(schema: str) -> list[str]:
    """Why one of them would not open a topic of this schema; empty: both do."""
    found: list[str] = []
    parts = re.split(r"^={3,}\n", schema, flags=re.MULTILINE)
    known = {part.splitlines()[0].removeprefix("MSG: ") for part in parts[1:]}
    for k, part in enumerate(parts):
        lines = part.splitlines()
        if k and not re.fullmatch(r"MSG: [\w]+/\w+", lines[0]):
            found.append(f"{lines[0]!r}: no name of a message")
        for line in lines[1:] if k else lines:
            if line and not line.startswith("#"):
                found += _line(line, known)
    return found


def _line(line: str, known: set[str]) -> list[str]:
    match = LINE.fullmatch(line)
    if match is None:
        return [f"{line!r}: no field"]
    kind, length, name, constant, _ = match.groups()
    if kind not in BUILT_IN and kind not in known:
        return [f"{line!r}: unknown type"]
    if kind.count("/") > 1 or (length and length != "[]" and int(length[1:-1]) > LONGEST):
        return [f"{line!r}: PlotJuggler leaves it out"]
    if constant is None:
        return [] if FIELD.fullmatch(name) else [f"{line!r}: name of a field"]
    if not CONSTANT.fullmatch(name):
        return [f"{line!r}: name of a constant"]
    low = 0 if kind.startswith("u") else -(2 ** BUILT_IN[kind])
    return [] if low <= int(constant[1:]) < 2 ** BUILT_IN[kind] else [f"{line!r}: out of range"]
