"""Keys: the place of a value in a tree of tables and lists, and its spelling.

("vehicles", "sat1", "start", 0) is `vehicles.sat1.start[0]`, in error messages as on the command
line. A name that is not a bare TOML key is quoted.
"""

import re
import tomllib

Key = tuple[str | int, ...]

ANY = "*"  # every entry of a table or list
DEEPEST = 32  # nesting depth; experiments have 7
LONGEST = 64  # shown characters of a name

_NAME = r"""[\w-]+|\*|"(?:[^"\\]|\\.)*"|'[^']*'"""
_INDEX = r"\[\s*(?:\d{1,6}|\*)\s*\]"
_STEP = rf"(?:{_NAME})(?:\s*{_INDEX})*"
_PART = re.compile(rf"{_INDEX}|{_NAME}")
_ASSIGNMENT = re.compile(rf"\s*({_STEP}(?:\s*\.\s*{_STEP})*)\s*=\s*(.*)", re.DOTALL)


def spell(key: Key) -> str:
    """The key as a string."""
    text = ""
    for part in key:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            name = part if len(part) <= LONGEST else part[:LONGEST] + "..."
            bare = re.fullmatch(r"[A-Za-z0-9_.-]+", name) and "." not in part
            text += "." * bool(text) + (name if bare else quoted(name))
    return text


def quoted(text: str) -> str:
    """A TOML string."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{printable(escaped)}"'


def printable(text: str) -> str:
    """The text with control characters escaped."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def assignment(text: str) -> tuple[Key, str]:
    """Key and value of "key = value".

    Raises:
        ValueError: the text does not have this form.
    """
    match = _ASSIGNMENT.fullmatch(text)
    if match is None:
        raise ValueError("expected key=value")
    key = tuple(_part(part) for part in _PART.findall(match[1]))
    if len(key) > DEEPEST:
        raise ValueError(f"a key of more than {DEEPEST} parts")
    return key, match[2].strip()


def _part(text: str) -> str | int:
    if text[0] == "[":
        index = text[1:-1].strip()
        return ANY if index == ANY else int(index)
    if text[0] in "\"'":
        return tomllib.loads(f"name = {text}")["name"]
    return text
