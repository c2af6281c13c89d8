"""A run flown again from its seed up to some tick, and on from there with changes.

The twin is deterministic, so flying again restores every memory of vehicles, laws and twin, and the
state of every random stream. A run on bench or table is fed from its log instead, and the twin goes
on from the estimate. Each tick up to the fork is compared with the log of the original.
"""

import math
import os
import shutil
from collections.abc import Callable, Sequence
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import Any

import msgspec
import tomli_w
from msgspec.structs import replace

from testbed.config import ConfigError, Experiment, Fork, dump, loads
from testbed.config.experiment import CHANGEABLE
from testbed.core.error import TestbedError
from testbed.core.rows import structs_of
from testbed.files import write_atomic
from testbed.logs.log_reader import LogReader, log_of
from testbed.logs.replay import Difference, before_damage, difference, parting
from testbed.logs.row_reader import RowReader
from testbed.report.fork_changes import changes_of_whole
from testbed.rig.interface import Rig
from testbed.rig.resumed import make_resumed
from testbed.run.missing_parts import lacks
from testbed.run.origin import NOTE, Origin

OF_THE_WHOLE = ("name", "description", "criteria", "duration_s")  # may change, for the whole run
TICKS = ("tick", "ending", "host")


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
    before = replace(original, forks=[one for one in original.forks if one.at_s <= t])
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
    (then, reads), (now, reads_now) = _ticks(original, t), _ticks(fork, t)
    found: list[Difference] = []
    for topic in {**then, **now}:
        pairs = zip_longest(then.get(topic, ()), now.get(topic, ()))
        for k, (one, other) in enumerate(pairs):
            if one == other:
                continue
            if one is None or other is None:
                numbers = (len(then.get(topic, ())), len(now.get(topic, ())))
                found.append(Difference(k, t, topic, "number of ticks", *numbers, None, "log"))
                break
            first = _between(k, topic, read(reads, topic, one), read(reads_now, topic, other),
                             on_board=on_board)  # fmt: skip
            if first is not None:
                found.append(first)
                break
    return min(found, key=lambda one: one.t, default=None)


def check_log(original: Path, t: float) -> None:
    """Refuse a log that lacks a part before `t`: a fork is compared with it up to there.

    Raises:
        ForkError: it is damaged, or cut off, before `t`.
        LogError: its beginning is missing.
    """
    book, until = LogReader(log_of(original)), round(1e9 * t)
    if any(row.stamp >= until for row in before_damage(book)) or not (lacking := lacks(book)):
        return
    last = book.damages[0].since if book.damages else book.last_s
    raise ForkError(
        where=str(original), expected=f"a log that is whole up to {t:g} s",
        found=f"one that is whole up to {last or 0.0:g} s", hint=lacking[0],
    )  # fmt: skip


def _between(k: int, topic: str, then: Any, now: Any, *, on_board: bool) -> Difference | None:
    """Where two ticks differ; their inputs come first."""
    before, after = (msgspec.to_builtins(one.inputs, enc_hook=structs_of) for one in (then, now))
    if (found := difference(before, after, "inputs")) is not None:
        return Difference(k, then.inputs.t, topic, *found, "twin")
    return parting(k, topic, then, now, law_on_board=on_board)


def _ticks(run: Path, t: float) -> tuple[dict[str, list[bytes]], RowReader]:
    """Rows of ticks before `t` by topic, and the reader that knows what they refer to."""
    until, rows, reader = round(1e9 * (t - 1e-6)), dict[str, list[bytes]](), RowReader()
    for topic, stamp, data in before_damage(LogReader(log_of(run))):
        kind = topic.rpartition("/")[2]
        if kind not in TICKS:
            reader.learn(topic, {"names": "Names", "event": "Event"}.get(kind, ""), data)
        elif stamp < until:
            rows.setdefault(topic, []).append(data)
    return rows, reader


def read(reader: RowReader, topic: str, data: bytes) -> Any:
    """The tick of a vehicle or of a host in a row."""
    return reader.host(topic, data) if topic.endswith("/host") else reader.tick(topic, data)


def resumed(original: Path, t: float) -> Callable[[Experiment], Rig]:
    """Builds the twin that goes on from `t` of a run on bench or table."""
    rows, reader = _ticks(original, t)
    ticks = [
        (topic.split("/")[1], read(reader, topic, data))
        for topic, each in rows.items()
        for data in each
    ]
    return partial(make_resumed, ticks)


def check_fork(
    original: Path, folder: Path, t: float, before: Experiment, after: Experiment
) -> None:
    """Compare a fork's log with that of its original, and note where it comes from.

    Args:
        original: its log.
        folder: of the fork.
        t: of the fork [s].
        before: experiment of the original.
        after: experiment of the fork.

    Raises:
        ForkError: they differ before `t`; the fork's folder is removed.
    """
    first = departure(original, folder, t, on_board=after.deploy.law == "vehicle")
    run = original.parent if original.name == "log.mcap" else original
    if first is not None:
        shutil.rmtree(folder)
        hint = f"the code is not the one that flew it: `testbed replay {run}` says more"
        if first.field.startswith("inputs.stick"):
            hint = f"it was flown by hand; a fork can begin up to {first.t:g} s"
        raise ForkError(
            where=f"fork of {run}", expected=f"the flight of its log up to {t:g} s",
            found=f"at {first.t:.3f} s, {first.topic}, {first.stage}: {first.field} was "
            f"{first.logged!r}, is {first.now!r}",
            hint=hint,
        )  # fmt: skip
    place = os.path.relpath(original.parent.resolve(), folder.resolve())
    whole = changes_of_whole(before, after, (*OF_THE_WHOLE, "inject"))
    note = Origin(place, t, _began(original), whole, original.name)
    write_atomic(folder / NOTE, msgspec.json.encode(note) + b"\n")


def _began(log: Path) -> int | None:
    """UTC at time 0 of a flight, from the first row of its log; None if it has none [ns]."""
    book = LogReader(log)
    next(book.read(), None)
    return book.epoch or None
