"""Makes paths in overrides of a file absolute: they are relative to that file, as in an experiment.

A worker, a resumed campaign and a printed command then read the same files from any folder.
"""

from pathlib import Path
from typing import Any

from controllers.law_file import file_of
from testbed.campaign.inline_toml import inline
from testbed.config.key import Key, assignment
from testbed.config.shipped import shipped
from testbed.config.source import value_of
from testbed.config.tree import leaves, trouble_at


def anchored(text: str, folder: Path) -> str:
    """An override with absolute paths for those that are relative to `folder`.

    Names of shipped files, and texts that are no overrides, stay as they are.
    """
    try:
        key, raw = assignment(text)
        value = value_of(raw)
    except ValueError:
        return text
    placed = _placed(key, value, folder.resolve())
    return text if placed == value else text.rstrip().removesuffix(raw) + inline(placed)


def files_of(text: str) -> list[Path]:
    """Files that an override with absolute paths names, in order; only those that exist."""
    try:
        key, raw = assignment(text)
        value = value_of(raw)
    except ValueError:
        return []
    texts = [(at, one) for at, one in leaves(value, key) if isinstance(one, str)]
    named = [_file(at, one, Path()) for at, one in texts]
    return [file for file in named if file is not None and trouble_at(file) is None]


def _placed(key: Key, value: Any, folder: Path) -> Any:
    if isinstance(value, dict):
        return {name: _placed((*key, name), child, folder) for name, child in value.items()}
    if isinstance(value, list):
        return [_placed((*key, i), child, folder) for i, child in enumerate(value)]
    return _path(key, value, folder) if isinstance(value, str) else value


def _path(key: Key, text: str, folder: Path) -> str:
    file = _file(key, text, folder)
    if file is None:
        return text
    return f"{file}:{text.rpartition(':')[2]}" if key[-1] == "law" else str(file)


def _file(key: Key, text: str, folder: Path) -> Path | None:
    """The file that a text at this key names; None: it names none, or a shipped one."""
    match key:
        case ("controller", "law") | ("forks", _, "controller", "law"):
            law = file_of(text)
            return None if law is None else folder / law
        case ("controller", "file") | ("forks", _, "controller", "file"):
            known: dict[str, Path] = {}
        case ("table",):
            known = shipped("tables")
        case ("vehicles", _, "model"):
            known = shipped("vehicles")
        case ("faults",):
            known = {}
        case _:
            return None
    file = folder / text
    return None if text in known and trouble_at(file) is not None else file
