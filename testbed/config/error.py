"""What is wrong in an input, in words an operator can act on."""

import difflib
from collections.abc import Iterable
from typing import NamedTuple

from testbed.config.key import Key, printable, quoted, spell

LONGEST = 72  # characters of a value that are shown


class Mistake(NamedTuple):
    """Something at `key` is not as it should be."""

    key: Key
    expected: str
    found: str


class ConfigError(Exception):
    """Something in the input is wrong; says where, what was expected and what was found."""

    def __init__(self, where: str, key: str, expected: str, found: str) -> None:
        self.where, self.key, self.expected, self.found = where, key, expected, found
        lines = [cut(printable(where), 300)] + [f"  key       {key}"] * bool(key)
        super().__init__("\n".join([*lines, f"  expected  {expected}", f"  found     {found}"]))


def refused(key: Key, error: Exception) -> Mistake:
    """What a struct or a law has against its values: "expected this, found that", or a sentence."""
    about, wanted, wish = str(error).partition("expected ")
    if not wanted:
        return Mistake(key, "values that fit together", about)
    expected, _, found = wish.partition(", found ")
    found = found or "values that do not fit it"
    return Mistake(key, expected, f"{found}: {about.rstrip(': ')}" if about else found)


def show(value: object) -> str:
    """A value as it would stand in a TOML file, cut when it is long."""
    return cut(_toml(value), LONGEST)


def cut(text: str, length: int) -> str:
    """The text, its end left out when it is long."""
    return text if len(text) <= length else text[: length - 3] + "..."


def _toml(value: object) -> str:
    match value:
        case bool():
            return str(value).lower()
        case int() if value.bit_length() > 128:  # Python refuses to print thousands of digits
            return f"a whole number of {value.bit_length()} bits"
        case str():
            return quoted(value[:LONGEST])
        case list():
            return f"[{', '.join(_toml(item) for item in value[:LONGEST])}]"
        case dict():
            return f"{{{', '.join(spell((name,)) + ' = ...' for name in list(value)[:LONGEST])}}}"
    return str(value)


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """A hint at the nearest known name, or nothing."""
    close = difflib.get_close_matches(name[:LONGEST], list(known), n=1)
    return f" (did you mean `{close[0]}`?)" if close else ""
