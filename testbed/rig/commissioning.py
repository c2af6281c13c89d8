"""Records of vehicles that passed `testbed commission`; good until vehicle, board or table change.

Arming asks for them with `arming.commissioned = true`, on the table.
"""

from hashlib import sha256
from pathlib import Path

import msgspec
from msgspec import Struct

from testbed.config import Experiment
from testbed.files import write_atomic
from testbed.rig.fault_latch import state_folder

AGAIN = "run `testbed commission` again"


class Record(Struct, frozen=True):
    """A vehicle that passed its commissioning."""

    day: str
    vehicle: str  # hash of its file
    table: str  # hash of the table file
    board: str  # the board's own words
    report: str  # folder of the report


def path_of(lab: str, name: str) -> Path:
    """File of a vehicle's record; on the host."""
    return state_folder() / f"commissioned-{lab}-{name}.json"


def hash_of(what: Struct) -> str:
    """Identifies a vehicle or a table."""
    return sha256(msgspec.json.encode(what)).hexdigest()[:16]


def record_of(experiment: Experiment, name: str, board: str, day: str, report: str) -> Record:
    """The record of a vehicle that passed."""
    model = experiment.vehicles[name].model
    return Record(day, hash_of(model), hash_of(experiment.table), board, report)


def save(experiment: Experiment, name: str, record: Record) -> Path:
    """Keep a record; returns its file.

    Raises:
        OSError: it cannot be written.
    """
    path = path_of(experiment.table.lab.network.lab, name)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(path, msgspec.json.encode(record))
    return path


def not_commissioned(experiment: Experiment, name: str, board: str) -> str:
    """Why a vehicle may not be armed; empty: it passed as it is now."""
    path = path_of(experiment.table.lab.network.lab, name)
    try:
        kept = msgspec.json.decode(path.read_bytes(), type=Record)
    except FileNotFoundError:
        return f"no record of it on this host: run `testbed commission`, or copy {path.name} here"
    except (OSError, msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        return f"{path}: {error}; {AGAIN}"
    now = record_of(experiment, name, board, kept.day, kept.report)
    for what in ("vehicle", "table"):
        if getattr(now, what) != getattr(kept, what):
            return f"its {what} file has changed since {kept.day}: {AGAIN}"
    if firmware(board) != firmware(kept.board):
        return f"{firmware(board)!r}, commissioned on {kept.day} with {firmware(kept.board)!r}"
    return ""


def firmware(board: str) -> str:
    """A board's words without its port, which may change."""
    return board.partition(" at ")[0]
