"""What a fork changes, with the old and the new values."""

from collections.abc import Iterator
from typing import Any

import msgspec

from testbed.config.experiment import CHANGEABLE, Experiment
from testbed.config.key import Key, spell
from testbed.report.law import law_of

SHOWN = 8  # values of a fork; more are counted


def fork_changes(experiment: Experiment) -> list[str]:
    """One sentence per fork."""
    found, before = [], experiment
    for at, after in experiment.stages():
        found.append(f"From {at:g} s on: {_changes(before, after)}.")
        before = after
    return found


def _changes(before: Experiment, after: Experiment) -> str:
    parts = []
    if law_of(before) != law_of(after):
        parts.append(f"another law, {law_of(before)} \N{RIGHTWARDS ARROW} {law_of(after)}")
    elif before.controller != after.controller:
        parts.append("other gains, " + _values(before, after, "controller"))
    for key in CHANGEABLE[1:]:
        if getattr(before, key) != getattr(after, key):
            parts.append(_values(before, after, key))
    return "; ".join(parts) or "a fork without changes of law, chain or seed"


def _values(before: Experiment, after: Experiment, part: str) -> str:
    old, new = (msgspec.to_builtins(getattr(one, part)) for one in (before, after))
    every = [
        f"{spell((part, *key))} {_word(a)} \N{RIGHTWARDS ARROW} {_word(b)}"
        for key, a, b in _pairs((), old, new)
    ]
    more = f" and {len(every) - SHOWN} more" if len(every) > SHOWN else ""
    return ", ".join(every[:SHOWN]) + more


def _pairs(key: Key, old: Any, new: Any) -> Iterator[tuple[Key, Any, Any]]:
    """Keys whose values differ, with both values; None where there is none."""
    if isinstance(old, dict) and isinstance(new, dict):
        for name in dict.fromkeys((*old, *new)):
            yield from _pairs((*key, name), old.get(name), new.get(name))
    elif isinstance(old, list | tuple) and isinstance(new, list | tuple) and len(old) == len(new):
        for k, (a, b) in enumerate(zip(old, new, strict=True)):
            yield from _pairs((*key, k), a, b)
    elif old != new:
        yield key, old, new


def _word(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, float):
        return f"{value:.6g}"
    return str(value)
