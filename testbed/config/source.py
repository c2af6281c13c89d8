"""Assembles the tree of an experiment, and records the origin of each part."""

import re
from contextlib import suppress
from copy import deepcopy
from pathlib import Path
from typing import Any, NamedTuple

from testbed.config.error import ConfigError, Violation, did_you_mean, show
from testbed.config.key import Key, assignment, spell
from testbed.config.own_law import place_law
from testbed.config.shipped import FAULTS, shipped
from testbed.config.tree import parse, read_toml, trouble_at

_BARE_WORD = re.compile(r"[^\W\d][\w./-]*|\.{0,2}/[\w./-]+")


class Origin(NamedTuple):
    """A file or an override, and the key of the tree that it gave."""

    where: str
    key: Key = ()


class Source:
    """A tree from `where`, with included files, relative to `folder`, and overrides."""

    def __init__(self, tree: dict[str, Any], where: str, folder: Path) -> None:
        self.tree = tree
        self._origins: dict[Key, Origin] = {(): Origin(where)}
        if isinstance(self.tree, dict) and "faults" not in self.tree:
            self.tree["faults"] = str(FAULTS)
        self._include(folder)

    def error(self, violation: Violation) -> ConfigError:
        """The violation as an error that names its file or override."""
        key, expected, found, hint = violation
        above = (key[:n] for n in range(len(key), -1, -1))
        origin = next(self._origins[part] for part in above if part in self._origins)
        inside = [
            o.where for k, o in self._origins.items() if k[: len(key)] == key != k and not o.key
        ]
        where = " with ".join(dict.fromkeys([origin.where, *inside[-1:]]))
        return ConfigError(where, spell(key[len(origin.key) :]), expected, found, hint)

    def override(self, text: str) -> None:
        """Apply "key=value".

        `*` in the key matches every entry; a path in the value is relative to the current folder.
        """
        try:
            text.encode()  # a shell may pass bytes that are not text
            key, raw = assignment(text)
        except ValueError as error:
            wanted = str(error) if str(error).startswith("key=value") else "key=value"
            raise ConfigError("command line", "", wanted, show(text)) from None
        origin = Origin(f"command line: {text}")
        value = _parse(origin, key, raw)
        spots: list[tuple[Key, Any]] = [((), self.tree)]
        for part in key[:-1]:
            for spot, parent in spots:
                if part == "*" and parent == {} and self._origins.get(spot) is origin:
                    raise self._unknown(origin, spot)
            spots = [
                self._enter(origin, *spot) for at in spots for spot in _meant(origin, *at, part)
            ]
        for at in spots:
            for spot, parent in _meant(origin, *at, key[-1]):
                parent[spot[-1]] = deepcopy(value)
                self._note(spot, origin)
        self._include(Path())

    def _unknown(self, origin: Origin, key: Key) -> ConfigError:
        """The error for `*` in a table that does not exist: its name is wrong."""
        parent: Any = self.tree
        for part in key[:-1]:
            parent = parent[part]
        known = [name for name in parent if name != key[-1]]
        found = f"no `{spell(key[-1:])}`{did_you_mean(str(key[-1]), known)}"
        return ConfigError(origin.where, spell(key), f"one of: {', '.join(known)}", found)

    def _enter(self, origin: Origin, key: Key, parent: Any) -> tuple[Key, Any]:
        """The entry `key` of its parent, made if missing."""
        if isinstance(parent, dict) and key[-1] not in parent:
            parent[key[-1]] = {}
            self._note(key, origin)
        return key, parent[key[-1]]

    def _note(self, key: Key, origin: Origin) -> None:
        """Record `origin` for `key` and everything below."""
        kept = {k: o for k, o in self._origins.items() if k[: len(key)] != key}
        self._origins = kept | {key: origin}

    def _include(self, folder: Path) -> None:
        """Replace paths, and names of shipped files, by the content of their files."""
        place_law(self.tree, folder)
        slots: list[tuple[Key, Any, str]] = [
            (("table",), self.tree, "tables"),
            (("faults",), self.tree, ""),
        ]
        vehicles = self.tree.get("vehicles")
        if isinstance(vehicles, dict):
            slots += [
                (("vehicles", own, "model"), one, "vehicles") for own, one in vehicles.items()
            ]
        for key, parent, kind in slots:
            name = parent.get(key[-1]) if isinstance(parent, dict) else None
            if isinstance(name, str):
                file = self._file(key, folder, name, shipped(kind) if kind else {}).resolve()
                parent[key[-1]] = read_toml(file)
                self._note(key, Origin(str(file), key))

    def _file(self, key: Key, folder: Path, name: str, known: dict[str, Path]) -> Path:
        """The file at the path `name`; where there is none, the shipped one of this name."""
        file = folder / name
        trouble = trouble_at(file)
        if trouble is None:
            return file
        if name in known:
            return known[name]
        names = f", or one of: {', '.join(known)}" if known else ""
        found = f"{show(name)}: {trouble}{did_you_mean(Path(name).stem, known)}"
        raise self.error(Violation(key, f"the path of a TOML file{names}", found))


def value_of(raw: str) -> Any:
    """The value of an override: TOML, or a bare word as a string.

    Raises:
        ValueError: it is neither.
    """
    try:
        tree = parse(f"value = {raw}".encode())
    except ValueError:
        if _BARE_WORD.fullmatch(raw):
            return raw
        raise
    if len(tree) > 1:
        raise ValueError("a second line")
    return tree["value"]


def _parse(origin: Origin, key: Key, raw: str) -> Any:
    """Parse the value of an override: TOML, or a bare word as a string."""
    with suppress(ValueError):
        return value_of(raw)
    expected = """a TOML value: a number, a word, [...], {...}, or text in quotes, 'key="..."'"""
    raise ConfigError(origin.where, spell(key), expected, show(raw) if raw else "nothing")


def _meant(origin: Origin, key: Key, parent: Any, part: str | int) -> list[tuple[Key, Any]]:
    """The entries of `parent` that `part` of a key matches: their keys, each with `parent`."""
    names: list[Any] = []
    found = ""
    match parent, part:
        case dict(), "*":
            names, expected = list(parent), "at least one entry"
        case list(), "*":
            names, expected = list(range(len(parent))), "at least one entry"
        case dict(), _:
            names, expected = [part], "a table"
        case list(), _:
            names = [i for i in range(len(parent)) if str(i + 1) == part]
            expected = f"a number from 1 to {len(parent)}, an entry of `{spell(key[-1:])}`"
            if not parent:
                expected = f"nothing: `{spell(key[-1:])}` is empty"
            found = str(part)
        case _:
            expected = "a table"
    if not names:
        raise ConfigError(origin.where, spell(key), expected, found or show(parent))
    return [((*key, name), parent) for name in names]
