"""Mapping files: which column of a lab's log is what, in which unit and frame."""

from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from testbed.config.error import ConfigError, did_you_mean, show
from testbed.config.key import spell
from testbed.config.number import bad_numbers
from testbed.config.shipped import SHIPPED
from testbed.config.tree import read_toml, trouble_at
from testbed.config.validation import first_violation
from testbed.core.vehicle import NonNegative, Point, Positive, Vehicle

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
RADIANS = {"rad": 1.0, "deg": 0.017453292519943295}


class Time(Struct, frozen=True, forbid_unknown_fields=True):
    """Name and unit of the time column."""

    column: str
    unit: Literal["s", "ms", "us", "ns"] = "s"


class Queue(Struct, frozen=True, forbid_unknown_fields=True):
    """A queue of camera frames, whose oldest is read; when full it is emptied."""

    frame_s: Positive  # between two frames; the rows of the log are further apart
    frames: Annotated[int, Meta(ge=1, le=100)]  # thrown away at once


class PoseColumns(Struct, frozen=True, forbid_unknown_fields=True):
    """The columns of the measured pose: counter-clockwise heading, any two axes of the table."""

    x: str
    y: str
    theta: str | None = None
    quaternion: tuple[str, str, str, str] | None = None  # x, y, z, w; instead of `theta`
    unit: Literal["m", "cm", "mm"] = "m"
    angle_unit: Literal["rad", "deg"] = "rad"
    new: str | None = None  # column that is 1 where the pose is a measurement, not a repetition
    middle: Point = (0.0, 0.0)  # the table's middle in the log's frame [m]
    latency_s: NonNegative = 0.0  # age of a pose at its time stamp
    queue: Queue | None = None  # poses are read from a queue of frames


class ValveColumns(Struct, frozen=True, forbid_unknown_fields=True):
    """The columns of the valve commands, in the order of the vehicle's jets."""

    columns: Annotated[list[str], Meta(min_length=1)]
    period_s: Positive  # a command is taken once per period and lasts for it
    kind: Literal["state", "duty", "us"] = "state"  # 0/1, share of the period, or open time [us]
    opens: Literal["first", "unknown"] = "first"  # when in its period: at its start, or not known
    phase_s: float | None = None  # a period starts at this time and at whole periods from it


class WrenchColumns(Struct, frozen=True, forbid_unknown_fields=True):
    """The columns of the commanded wrench [N, N, N m]."""

    fx: str
    fy: str
    tau: str | None = None
    frame: Literal["table", "body"] = "body"


class Mapping(Struct, frozen=True, forbid_unknown_fields=True):
    """A lab's log: its columns, and the rows that are free flight."""

    time: Time
    pose: PoseColumns
    valves: ValveColumns | None = None
    wrench: WrenchColumns | None = None
    use: dict[str, list[float]] = {}  # column -> values of usable rows; other rows are left out
    rows: dict[str, list[float | str]] = {}  # column -> values of this vehicle's rows
    topic: str | None = None  # of an MCAP file with several
    name: str = ""
    table: Point | None = None  # size of the table [m]
    vehicles: list[str] = []  # names of the vehicle files that a log may be of


def load_mapping(name: str) -> Mapping:
    """A mapping given as a file or as the name of a shipped one.

    Raises:
        ConfigError: it is missing or invalid.
    """
    path = named_file(name, "mappings", "a mapping file")
    tree = read_toml(path)
    mapping: Mapping = convert(tree, Mapping, path)  # type: ignore[assignment]
    if (mapping.valves is None) == (mapping.wrench is None):
        found = "both" if mapping.valves else "neither"
        raise ConfigError(str(path), "", "either [valves] or [wrench]", found)
    if (mapping.pose.theta is None) == (mapping.pose.quaternion is None):
        found = "both" if mapping.pose.theta else "neither"
        raise ConfigError(str(path), "pose.theta", "either theta or quaternion", found)
    # a quaternion may name one twice: in the plane two of its numbers are zero
    used = [mapping.time.column, mapping.pose.x, mapping.pose.y]
    used += [mapping.pose.theta] if mapping.pose.theta else []
    used += mapping.valves.columns if mapping.valves else []
    if twice := [name for k, name in enumerate(used) if name in used[:k]]:
        raise ConfigError(str(path), "", "each column once", f"{show(twice[0])} twice")
    return mapping


def check_valves(name: str | None, vehicle: Vehicle) -> None:
    """Check that a mapping has a valve column for each jet of the vehicle.

    Raises:
        ConfigError: it has fewer or more.
    """
    valves = load_mapping(name).valves if name else None
    if name and valves and len(valves.columns) != len(vehicle.jets):
        expected = f"{len(vehicle.jets)} columns, in the order of the vehicle's jets"
        raise ConfigError(name, "valves.columns", expected, str(len(valves.columns)))


def named_file(name: str, folder: str, what: str) -> Path:
    """A file given as a path, or as the name of a shipped one in `folder`."""
    trouble = trouble_at(Path(name))
    if trouble is None:
        return Path(name)
    known = {file.stem: file for file in sorted((SHIPPED / folder).glob("*.toml"))}
    if name in known:
        return known[name]
    expected = f"{what} or one of: {', '.join(known)}"
    raise ConfigError(name, "", expected, trouble + did_you_mean(Path(name).stem, known))


def convert(tree: dict[str, object], kind: type, path: Path) -> Struct:
    """The tree of a file as a struct.

    Raises:
        ConfigError: it does not fit.
    """
    for key, *said in bad_numbers(tree):
        raise ConfigError(str(path), spell(key), *said)
    try:
        converted: Struct = msgspec.convert(tree, kind)
    except msgspec.ValidationError:
        key, expected, found, _ = first_violation(tree, kind)
        raise ConfigError(str(path), spell(key), expected, found) from None
    return converted
