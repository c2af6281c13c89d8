"""Finds and reads the shipped papers.

A run with `like` inherits all keys of another run in the same file; its own keys override them.
"""

from collections.abc import Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

import msgspec

from testbed.config import SHIPPED, ConfigError, read_toml
from testbed.config.error import did_you_mean
from testbed.config.key import spell
from testbed.config.validation import first_violation
from testbed.reproduction.claim import Paper

PAPERS = SHIPPED / "papers"
EVERY = "all"


def keys() -> list[str]:
    """Keys of all papers."""
    return sorted(path.stem for path in PAPERS.glob("*.toml"))


def chosen(key: str) -> list[str]:
    """The papers selected by `key`.

    Raises:
        ConfigError: no paper has this key.
    """
    known = keys()
    if key == EVERY:
        return known
    if key not in known:
        expected = f"one of: {', '.join([*known, EVERY])}"
        raise ConfigError("command line", "", expected, key + did_you_mean(key, known))
    return [key]


def read_paper(path: Path) -> Paper:
    """Read a paper's file.

    Raises:
        ConfigError: the file is invalid.
    """
    tree = read_toml(path)
    try:
        complete_runs(tree.get("runs"))
    except ValueError as error:
        raise ConfigError(str(path), "runs", "a run to be like", str(error)) from None
    try:
        return msgspec.convert(tree, Paper)
    except msgspec.ValidationError:
        violation = first_violation(tree, Paper)
        raise ConfigError(
            str(path), spell(violation.key), violation.expected, violation.found
        ) from None


def complete_runs(runs: Any) -> None:
    """Fill in, in place, the keys that runs inherit from others.

    Raises:
        ValueError: `like` names an unknown run, or is circular.
    """
    if not isinstance(runs, dict):
        return
    for name, run in runs.items():
        chain = [name]
        while isinstance(run, dict) and "like" in run:
            model = run.pop("like")
            if not isinstance(model, str) or model not in runs or model in chain:
                raise ValueError(f"{chain[-1]}: `like = {model!r}` is circular or names no run")
            chain.append(model)
            run = merged(runs[model], run)
        runs[name] = run


def merged(under: Any, over: Any) -> Any:
    """Merge tables recursively; other values of `over` replace those of `under`."""
    if not (isinstance(under, dict) and isinstance(over, dict)):
        return deepcopy(over)
    names = dict.fromkeys([*under, *over])
    return {
        name: merged(under.get(name), over[name]) if name in over else deepcopy(under[name])
        for name in names
    }


def read_papers(names: Sequence[str]) -> dict[str, Paper]:
    """Papers by key."""
    return {name: read_paper(PAPERS / f"{name}.toml") for name in names}
