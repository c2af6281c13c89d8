"""Errors in inputs, with text that an operator can act on."""

from typing import NamedTuple

from testbed.config.key import Key, printable, quoted, spell
from testbed.core.error import MismatchError, TestbedError
from testbed.core.spelling import did_you_mean as did_you_mean

LONGEST = 72  # shown characters of a value


class Violation(NamedTuple):
    """An invalid value: its key, what was expected and found."""

    key: Key
    expected: str
    found: str
    hint: str = ""


class ConfigError(TestbedError):
    """An invalid input: where, what was expected, what was found, and what to do if known."""

    def __init__(
        self, where: str, key: str, expected: str, found: str, hint: str = ""
    ) -> None:  # fmt: skip
        lines = [cut(printable(where), 300)] + [f"  key       {key}"] * bool(key)
        super().__init__("\n".join(lines), where=where, expected=expected, found=found, hint=hint)
        self.key = key


def refused(key: Key, error: Exception) -> Violation:
    """The error of a struct's own check, or of a law, as a Violation."""
    cause = error if isinstance(error, MismatchError) else error.__cause__
    if not isinstance(cause, MismatchError):
        return Violation(key, "values that fit together", str(error))
    expected, found, about = cause.args
    return Violation(key, expected, f"{found}: {about}" if about else found)


def show(value: object) -> str:
    """A value as TOML, truncated if long."""
    return cut(_toml(value), LONGEST)


def cut(text: str, length: int) -> str:
    """The text, truncated to `length` characters."""
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
