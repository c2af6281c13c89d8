"""A run flown again from its seed up to some tick, and on from there with changes.

The twin is deterministic, so flying again restores every memory of vehicles, laws and twin, and the
state of every random stream. Each tick up to the fork is compared with the log of the original.
"""

import math
import os
import shutil
from collections.abc import Iterator, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

import msgspec
import tomli_w
from msgspec import Struct
from msgspec.structs import replace

from testbed.config import ConfigError, Experiment, Fork, dump, loads
from testbed.config.experiment import CHANGEABLE
from testbed.core.error import TestbedError
from testbed.files import write_atomic
from testbed.logs.log_reader import LogReader, config_of, log_of
from testbed.logs.replay import Difference, before_damage, difference, parting
from testbed.logs.row_reader import RowReader

OF_THE_WHOLE = ("name", "description", "criteria", "duration_s")  # may change, for the whole run
TICKS = ("tick", "ending", "host")
NOTE = "fork.json"


class Origin(Struct, frozen=True):
    """Where a fork comes from; in fork.json of its folder."""

    run: str  # folder of the original, relative to the fork's
    t: float  # [s]


class ForkError(TestbedError):
    """A run cannot be forked."""


def forked(original: Experiment, t: float, overrides: Sequence[str]) -> Experiment:
    """The experiment of a fork: flies like the original up to `t`, then with the overrides.

    Raises:
        ConfigError: an override is wrong, or changes what was settled before `t`.
    """
    if not math.isfinite(t) or not 0.0 <= t < original.end_s:
        expected = f"a time of the flight, from 0 to less than {original.end_s:g} s"
        raise ConfigError("fork", "from", expected, f"{t:g}")
    before = replace(original, forks=[one for one in original.forks if one.at_s < t])
    base = next((stage for _, stage in reversed(before.stages())), replace(before, forks=[]))
    changed = loads(tomli_w.dumps(dump(base)), overrides)
    values: dict[str, Any] = {}
    for key in base.__struct_fields__:
        value = getattr(changed, key)
        if getattr(base, key) == value:
            continue
        if key == "inject":
            _only_later(base, changed, t)
        elif key not in CHANGEABLE + OF_THE_WHOLE:
            known = ", ".join((*CHANGEABLE, "inject", *OF_THE_WHOLE))
            expected = f"one of: {known}; the rest is settled when the flight begins"
            raise ConfigError("fork", key, expected, f"another `{key}`")
        values[key] = value
    fork = Fork(t, **{key: value for key, value in values.items() if key in CHANGEABLE})
    whole = {key: value for key, value in values.items() if key not in CHANGEABLE}
    made = replace(before, forks=[*before.forks, fork], **whole)
    return loads(tomli_w.dumps(dump(made)))  # checked together


def _only_later(base: Experiment, changed: Experiment, t: float) -> None:
    """Refuse to change injected faults that began before `t`, or may have."""

    def begun(experiment: Experiment) -> list[Any]:
        return [one for one in experiment.inject if one.at_s is None or one.at_s < t]

    if begun(base) != begun(changed):
        expected = f"the faults from before {t:g} s as they were, and new ones with at_s >= {t:g}"
        raise ConfigError(
            "fork", "inject", expected, f"{len(changed.inject)} faults, others before"
        )


def departure(original: Path, fork: Path, t: float, *, on_board: bool) -> Difference | None:
    """The first tick before `t` at which a fork's log is not that of the original."""
    then_reads, now_reads = RowReader(), RowReader()
    rows = zip_longest(_ticks(original, t, then_reads), _ticks(fork, t, now_reads))
    for k, (one, other) in enumerate(rows):
        if one is None or other is None or one[:2] != other[:2]:
            was, now = (None if tick is None else tick[0] for tick in (one, other))
            return Difference(k, t, "log", "which tick comes next", was, now, None, "order")
        if one[2] == other[2]:
            continue
        ticks = [
            reads.host(one[0], data) if one[0].endswith("/host") else reads.tick(one[0], data)
            for reads, data in ((then_reads, one[2]), (now_reads, other[2]))
        ]
        before, after = map(msgspec.to_builtins, ticks)
        if (found := difference(before["inputs"], after["inputs"], "inputs")) is not None:
            return Difference(k, ticks[0].inputs.t, one[0], *found, "twin")
        if (first := parting(k, one[0], *ticks, law_on_board=on_board)) is not None:
            return first
    return None


def _ticks(run: Path, t: float, reader: RowReader) -> Iterator[tuple[str, int, bytes]]:
    """Rows of ticks before `t`; the reader learns what they refer to."""
    until = round(1e9 * (t - 1e-6))
    for topic, stamp, data in before_damage(LogReader(log_of(run))):
        kind = topic.rpartition("/")[2]
        if kind not in TICKS:
            reader.learn(topic, {"names": "Names", "event": "Event"}.get(kind, ""), data)
        elif stamp < until:
            yield topic, stamp, data


def check_fork(original: Path, folder: Path, t: float, *, on_board: bool) -> None:
    """Compare a fork's log with that of its original, and note where it comes from.

    Raises:
        ForkError: they differ before `t`; the fork's folder is removed.
    """
    first = departure(original, folder, t, on_board=on_board)
    if first is not None:
        shutil.rmtree(folder)
        raise ForkError(
            where=f"fork of {original}", expected=f"the flight of its log up to {t:g} s",
            found=f"at {first.t:.3f} s, {first.topic}, {first.stage}: {first.field} was "
            f"{first.logged!r}, is {first.now!r}",
            hint=f"the code is not the one that flew it: `testbed replay {original}` says more",
        )  # fmt: skip
    note = Origin(os.path.relpath(original.resolve(), folder.resolve()), t)
    write_atomic(folder / NOTE, msgspec.json.encode(note) + b"\n")


def origin_of(folder: Path) -> tuple[Path, float] | None:
    """The folder of a fork's original, if it is still there, and the time of the fork [s]."""
    try:
        note = msgspec.json.decode((folder / NOTE).read_bytes(), type=Origin)
        log_of(folder / note.run)
    except (OSError, msgspec.DecodeError, TestbedError):
        return None
    return folder / note.run, note.t


def original_of(run: Path) -> Path:
    """The folder of a run that can be forked.

    Raises:
        TestbedError: there is no such run.
    """
    log_of(run)
    return config_of(run).parent
