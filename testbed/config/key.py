"""Keys: the place of a value in a tree of tables and lists, and its spelling.

("vehicles", "sat1", "start", 0) is `vehicles.sat1.start.1`, in error messages as on the command
line: entries of a list count from 1, as jets do. A name that is not a bare TOML key is quoted.
"""

import re
import tomllib

Key = tuple[str | int, ...]

ANY = "*"  # every entry of a table or list
DEEPEST = 32  # nesting depth; experiments have 7
LONGEST = 64  # shown characters of a name

_NAME = r"""[\w-]+|\*|"(?:[^"\\]|\\.)*"|'[^']*'"""
_PART = re.compile(_NAME)
_ASSIGNMENT = re.compile(rf"\s*((?:{_NAME})(?:\s*\.\s*(?:{_NAME}))*)\s*=\s*(.*)", re.DOTALL)
_BRACKET = re.compile(r"""[^="']*\[""")


def spell(key: Key) -> str:
    """The key as in an override: `vehicles.sat1.goal`."""
    return ".".join(_spell(part) for part in key)


def _spell(part: str | int) -> str:
    if isinstance(part, int):
        return str(part + 1)
    name = part if len(part) <= LONGEST else part[:LONGEST] + "..."
    bare = re.fullmatch(r"[A-Za-z0-9_.-]+", name) and "." not in part
    return name if bare else quoted(name)


def quoted(text: str) -> str:
    """The text as a TOML string, quoted and escaped."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{printable(escaped)}"'


def printable(text: str) -> str:
    """The text with control characters escaped."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def assignment(text: str) -> tuple[Key, str]:
    """Key and value of "key = value"; a list's entry is its number as text.

    Raises:
        ValueError: the text does not have this form; says what was expected.
    """
    match = _ASSIGNMENT.fullmatch(text)
    if match is None:
        lists = " with `jets.1` for the first entry of a list, `jets.*` for all"
        raise ValueError("key=value" + lists * bool(_BRACKET.match(text)))
    key = tuple(_part(part) for part in _PART.findall(match[1]))
    if len(key) > DEEPEST:
        raise ValueError(f"key=value with a key of at most {DEEPEST} parts")
    return key, match[2].strip()


def _part(text: str) -> str:
    if text[0] in "\"'":
        return tomllib.loads(f"name = {text}")["name"]
    return text
