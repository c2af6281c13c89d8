"""What a fork changes, with the old and the new values."""

from collections.abc import Iterator, Sequence
from typing import Any

import msgspec

from testbed.config.experiment import CHANGEABLE, Experiment
from testbed.config.key import Key, spell
from testbed.report.law import law_of

SHOWN = 8  # values of a fork; more are counted


def fork_changes(experiment: Experiment, whole: Sequence[str] = ()) -> list[str]:
    """One sentence per fork.

    Args:
        experiment: of the fork.
        whole: changes of the last fork that no stage has, from `changes_of_whole`.
    """
    found, before, stages = [], experiment, experiment.stages()
    for k, (at, after) in enumerate(stages, 1):
        parts = [*_changes(before, after), *(whole if k == len(stages) else ())]
        sentences = "; ".join(parts) or "a fork without changes of law, chain or seed"
        found.append(f"From {at:g} s on: {sentences}.")
        before = after
    return found


def changes_of_whole(before: Experiment, after: Experiment, keys: Sequence[str]) -> list[str]:
    """Values of these keys of an experiment that differ, old and new."""
    return [
        _values(before, after, key) for key in keys if getattr(before, key) != getattr(after, key)
    ]


def _changes(before: Experiment, after: Experiment) -> list[str]:
    parts = []
    if law_of(before) != law_of(after):
        parts.append(f"another law, {law_of(before)} \N{RIGHTWARDS ARROW} {law_of(after)}")
    elif before.controller != after.controller:
        parts.append("other gains, " + _values(before, after, "controller"))
    for key in CHANGEABLE[1:]:
        if getattr(before, key) != getattr(after, key):
            parts.append(_values(before, after, key))
    return parts


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
    if isinstance(value, list) and all(isinstance(one, dict) for one in value):
        return f"{len(value)} listed"
    return str(value)
