"""Where a fork comes from: the note in its folder, and the original as its report draws it."""

from pathlib import Path

import msgspec
import numpy as np
from msgspec import Struct

from testbed.core.error import TestbedError
from testbed.logs.history import History, VehicleHistory, gather
from testbed.logs.log_reader import LogReader
from testbed.report.original import Original
from testbed.run.recorded import SAME_NS

NOTE = "fork.json"
BEFORE_S = 1e-6  # ticks up to this long before a fork are the original's


class Origin(Struct, frozen=True):
    """Where a fork comes from; in fork.json of its folder."""

    run: str  # folder of the original, relative to the fork's
    t: float  # [s]
    epoch_ns: int | None = None  # UTC at time 0 of the original; null: not known
    whole: list[str] = []  # changes that count for the whole run, with both values
    log: str = "log.mcap"  # name of the original's log


def read_origin(folder: Path) -> Origin | None:
    """The note of a fork; None if the run is no fork."""
    try:
        return msgspec.json.decode((folder / NOTE).read_bytes(), type=Origin)
    except (OSError, msgspec.DecodeError):
        return None


def drawn_original(folder: Path, note: Origin, fork: History) -> tuple[Original | None, list[str]]:
    """The original, if its folder still holds it, else a line that says why it is not drawn.

    A log that was renamed since the fork is found by its ticks.
    """
    run = folder / note.run
    logs = [run / note.log] if (run / note.log).is_file() else sorted(run.glob("*.mcap"))
    why = "has no log"
    for log in logs:
        found, why = _drawn(log, note, fork)
        if found is not None:
            return found, []
    return None, [f"the original of this fork is not drawn: {note.run} {why}"]


def _drawn(log: Path, note: Origin, fork: History) -> tuple[Original | None, str]:
    """The original, if a log is of it, else why not."""
    try:
        book = LogReader(log)
        history = gather(book)
    except (TestbedError, OSError) as error:
        return None, f"has a log that cannot be read ({str(error).splitlines()[0]})"
    other_flight = note.epoch_ns is not None and abs(book.epoch - note.epoch_ns) > SAME_NS
    if other_flight or not same_until(note.t, history, fork):
        return None, "is another run, or its log is damaged"
    return Original(log.parent.resolve().name, note.t, history), ""


def same_until(t: float, original: History, fork: History) -> bool:
    """Whether two flights have the same ticks before `t`, to the bit."""
    if original.vehicles.keys() != fork.vehicles.keys():
        return False
    pairs = [(original.vehicles[name], fork.vehicles[name]) for name in fork.vehicles]
    return all(_same(t, *pair) for pair in pairs)


def _same(t: float, one: VehicleHistory, other: VehicleHistory) -> bool:
    a, b = (np.searchsorted(v.t, t - BEFORE_S) for v in (one, other))
    return all(
        np.array_equal(getattr(one, key)[:a], getattr(other, key)[:b], equal_nan=True)
        for key in ("t", "pose", "twist", "reference", "on")
    )
