"""Reads TOML text into a tree of tables, lists and values."""

import re
import tomllib
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

from testbed.config.error import ConfigError
from testbed.config.key import DEEPEST, Key

LARGEST = 1_000_000  # size of a file [bytes]; the shipped ones have 3000

# tomllib's memory grows with the square of the parts of a dotted key: 100 000 of them are 40 GB.
_LONG_KEY = re.compile(rf"(?<![^\s.=,\[\]{{}}#])(?:[^\s.=,\[\]{{}}#]++\s*+\.\s*+){{{DEEPEST}}}")


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file as a tree of tables."""
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST + 1)
    except (OSError, ValueError) as error:  # ValueError: an invalid path
        reason = error.strerror if isinstance(error, OSError) else None
        raise ConfigError(str(path), "", "a readable file", reason or str(error)) from None
    return read_text(data, str(path))


def read_text(data: bytes, where: str) -> dict[str, Any]:
    """TOML text as a tree of tables; `where` names its source."""
    try:
        return cast(dict[str, Any], _copied(_parsed(data)))
    except ValueError as error:
        raise ConfigError(where, "", "a TOML file", str(error)) from None


def parse(data: bytes) -> dict[str, Any]:
    """TOML text as a tree of tables.

    Raises:
        ValueError: it is not TOML, or too large or too deeply nested.
    """
    if len(data) > LARGEST:
        raise ValueError(f"more than {LARGEST / 1e6:g} MB")
    text = data.decode("utf-8-sig")  # Windows editors write a byte order mark
    if _LONG_KEY.search(text):
        raise ValueError(f"a key of more than {DEEPEST} parts")
    try:
        tree = tomllib.loads(text)
    except RecursionError:
        raise ValueError(f"more than {DEEPEST} tables or lists in each other") from None
    level: list[Any] = [tree]
    for _ in range(DEEPEST):
        level = [child for node in level for child in _children(node)]
    if level:
        raise ValueError(f"more than {DEEPEST} tables or lists in each other")
    return tree


# the same vehicle is read for each name, and the same experiment for each run of a campaign
_parsed = lru_cache(maxsize=16)(parse)


def _copied(node: Any) -> Any:
    """Tables and lists anew; TOML's values cannot be changed."""
    if isinstance(node, dict):
        return {name: _copied(child) for name, child in node.items()}
    return [_copied(child) for child in node] if isinstance(node, list) else node


def _children(node: Any) -> list[Any]:
    if isinstance(node, dict):
        return list(node.values())
    return node if isinstance(node, list) else []


def leaves(node: Any, key: Key = ()) -> Iterator[tuple[Key, Any]]:
    """Every value that is not a table or list, and its key."""
    if isinstance(node, dict):
        for name, child in node.items():
            yield from leaves(child, (*key, name))
    elif isinstance(node, list):
        for i, child in enumerate(node):
            yield from leaves(child, (*key, i))
    else:
        yield key, node


def trouble_at(path: Path) -> str | None:
    """Why there is no file at `path`; None if it exists."""
    try:
        if path.is_file():
            return None
        return "it is a folder" if path.is_dir() else "no such file"
    except OSError as error:
        return error.strerror
