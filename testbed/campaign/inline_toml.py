"""Writes a value as TOML on one line, for "key=value"."""

import re
from typing import Any

from testbed.config.key import quoted


def inline(value: Any) -> str:
    """The value as TOML; a number reads back as the same number."""
    match value:
        case bool():
            return str(value).lower()
        case str():
            return quoted(value)
        case int() | float():
            return repr(value)
        case list() | tuple():
            return f"[{', '.join(inline(item) for item in value)}]"
        case dict():
            return f"{{{', '.join(f'{_name(k)} = {inline(v)}' for k, v in value.items())}}}"
    return quoted(str(value))  # a date: no key accepts one, and the error says so


def _name(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else quoted(key)
