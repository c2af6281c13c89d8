"""Exports a log as tables: one per topic, one row per message, one column per number.

Units are SI and radians, times are seconds of the run, unless a name has another unit (`on_us`).
Nested fields are joined with dots (`outputs.state.pose.x`); sequences become `samples[0].x`,
`samples[1].x`, .... A row with fewer elements has NaN in the columns of the others, so these are
columns of float64, whole numbers (`pulses[0].on_us`) too. Standard messages repeat what rows have
and are left out. `bag` is a folder for `ros2 bag`, which has all messages: a copy of the log. A log
that is damaged or has no end gives a new file with what is intact: other programs read no damaged
one.
"""

import csv
import errno
import os
import re
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer
from numpy.typing import NDArray

from testbed.core.error import TestbedError
from testbed.core.extra import pip_install
from testbed.core.records import cdr
from testbed.core.records.definition import MESSAGES
from testbed.core.records.ros import ros_name, schema_text
from testbed.files import atomic_write
from testbed.logs.columns import Columns
from testbed.logs.log_reader import LogError, LogReader

UNITS = "SI and radians, times in seconds of the run, unless a name has another unit (on_us)"
PLUMBING = {"header", "reserved"}  # fields without a meaning for readers

Table = dict[str, NDArray[Any]]


class ExportError(TestbedError):
    """The export cannot be written."""


def tables(book: LogReader) -> dict[str, Table]:
    """Every topic of our own messages as a table of columns of equal length."""
    log = Columns(book)
    found = {topic: dict(_columns("", rows)) for topic, rows in log.rows.items()}
    for topic, texts in log.texts.items():
        definition = MESSAGES[book.kinds[topic]]
        try:
            messages = [cdr.decode(definition, one) for one in texts]
        except cdr.CdrError as error:
            raise LogError(f"{topic}: {error}") from None
        found[topic] = {
            one.name: np.array([_plain(message[one.name]) for message in messages])
            for one in definition.fields
        }
    if not found:
        raise LogError("there are no messages in the log")
    return found


def _plain(value: Any) -> Any:
    return ", ".join(value) if isinstance(value, list) else value


def _columns(path: str, rows: NDArray[Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Name and values of every number of some records."""
    names = rows.dtype.names or ()
    for name in names:
        if name in PLUMBING or (name.endswith("_length") and f"{name[:-7]}_valid" in names):
            continue
        inner = f"{path}.{name}" if path else name
        values = rows[name]
        if values.ndim == 1:
            yield from _columns(inner, values) if values.dtype.names else [(inner, values)]
            continue
        valid = rows[f"{name}_valid"] if f"{name}_valid" in names else None
        for k in range(values.shape[1] if valid is None else int(valid.max(initial=0))):
            one = values[:, k]
            parts = _columns(f"{inner}[{k}]", one) if one.dtype.names else [(f"{inner}[{k}]", one)]
            for place, column in parts:
                if valid is not None:  # whole numbers are uint32 at most: exact as float64
                    column = np.where(valid > k, column, np.nan)
                yield place, column


def _names(found: Mapping[str, Table], folder: Path, ending: str) -> dict[str, Path]:
    """A new file path for each topic.

    Raises:
        FileExistsError: a file exists; nothing has been written then.
    """
    paths = {t: folder / f"{t.strip('/').replace('/', '_')}.{ending}" for t in found}
    for path in paths.values():
        refuse_older(path)
    return paths


def refuse_older(path: Path) -> None:
    """Raise FileExistsError instead of overwriting a file."""
    if path.exists():
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))


def to_csv(found: dict[str, Table], folder: Path) -> list[Path]:
    """Write one CSV file per topic."""
    paths = _names(found, folder, "csv")
    for topic, table in found.items():
        with (
            atomic_write(paths[topic]) as part,
            part.open("w", newline="", encoding="utf-8") as file,
        ):
            writer = csv.writer(file)
            writer.writerow(table)
            writer.writerows(zip(*(column.tolist() for column in table.values()), strict=True))
    return list(paths.values())


def to_npz(found: dict[str, Table], folder: Path) -> list[Path]:
    """Write one NPZ file; array names are like `sat1/tick/outputs.state.pose.x`."""
    path = folder / "log.npz"
    refuse_older(path)
    arrays = {
        f"{topic.strip('/')}/{name}": column
        for topic, table in found.items()
        for name, column in table.items()
    }
    with atomic_write(path) as part, part.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    return [path]


def to_parquet(found: dict[str, Table], folder: Path) -> list[Path]:
    """Write one Parquet file per topic; needs pyarrow."""
    try:
        import pyarrow as arrow
        from pyarrow import parquet
    except ImportError:
        raise ExportError(f"parquet needs pyarrow: {pip_install('export')}") from None
    paths = _names(found, folder, "parquet")
    for topic, table in found.items():
        with atomic_write(paths[topic]) as part:
            rows = arrow.table(table, metadata={"topic": topic, "units": UNITS})
            parquet.write_table(rows, part, compression="zstd")
    return list(paths.values())


def to_mat(found: dict[str, Table], folder: Path) -> list[Path]:
    """Write one MATLAB file: `load log.mat`, then `sat1.tick.outputs.state.pose.x`.

    Raises:
        ExportError: two names are the same in MATLAB.
    """
    from scipy.io import savemat

    path = folder / "log.mat"
    refuse_older(path)
    firsts = dict.fromkeys(topic.strip("/").split("/")[0] for topic in found)
    _check_apart(firsts)
    tree: dict[str, Any] = {}
    for topic, table in found.items():
        first, *others = topic.strip("/").split("/")
        for name, column in table.items():
            *places, last = [_variable(first), *map(_matlab, (*others, *name.split(".")))]
            branch = tree
            for place in places:
                branch = branch.setdefault(place, {})
            branch[last] = column.astype(object) if column.dtype.kind == "U" else column
    with atomic_write(path) as part, part.open("wb") as file:
        savemat(file, tree, long_field_names=True, oned_as="column", do_compression=True)
    return [path]


def _matlab(name: str) -> str:
    """A name that MATLAB takes: `samples[0]` is `samples_1` there."""
    head, _, number = name.rstrip("]").partition("[")
    return f"{head}_{int(number) + 1}" if number else head


def _variable(name: str) -> str:
    """A vehicle's name as MATLAB takes it: `sat-1` is `sat_1` there, and `1` is `x1`."""
    spelled = name.replace("-", "_")
    return spelled if re.match(r"[A-Za-z]", spelled) else f"x{spelled}"


def _check_apart(names: Iterable[str]) -> None:
    taken: dict[str, str] = {}
    for name in names:
        other = taken.setdefault(_variable(name), name)
        if other != name:
            raise ExportError(
                where="export to mat", expected="vehicles whose names differ in MATLAB",
                found=f"{other} and {name}, which are both {_variable(name)}",
                hint="export to npz, csv or parquet",
            )  # fmt: skip


WRITERS: dict[str, Callable[[dict[str, Table], Path], list[Path]]] = {
    "csv": to_csv, "mat": to_mat, "npz": to_npz, "parquet": to_parquet,
}  # fmt: skip


def to_bag(book: LogReader, folder: Path) -> list[Path]:
    """Write a folder for `ros2 bag`: the log, and its table of contents.

    Raises:
        FileExistsError: the folder has one of these files, for instance the log of another run.
        LogError: there are no messages in the log.
    """
    for name in ("metadata.yaml", "log.mcap"):
        refuse_older(folder / name)
    counts: dict[str, int] = {}
    stamps = []
    for row in book.read():
        counts[row.topic] = counts.get(row.topic, 0) + 1
        stamps.append(book.epoch + row.stamp)
    if not stamps:
        raise LogError("there are no messages in the log")
    with atomic_write(folder / "log.mcap") as part:
        if book.complete():
            shutil.copyfile(book.path, part)
        else:
            _write_intact(book.path, part)
    began, ended = min(stamps), max(stamps)
    topics = "".join(
        f"""
    - topic_metadata:
        name: {topic}
        type: {ros_name(book.kinds[topic])}
        serialization_format: cdr
        offered_qos_profiles: ""
      message_count: {count}"""
        for topic, count in counts.items()
    )
    text = f"""rosbag2_bagfile_information:
  version: 5
  storage_identifier: mcap
  duration:
    nanoseconds: {ended - began}
  starting_time:
    nanoseconds_since_epoch: {began}
  message_count: {len(stamps)}
  topics_with_message_count:{topics}
  compression_format: ""
  compression_mode: ""
  relative_file_paths:
    - log.mcap
  files:
    - path: log.mcap
      starting_time:
        nanoseconds_since_epoch: {began}
      duration:
        nanoseconds: {ended - began}
      message_count: {len(stamps)}
"""
    with atomic_write(folder / "metadata.yaml") as part:
        part.write_text(text, encoding="utf-8")
    return [folder / "log.mcap", folder / "metadata.yaml"]


def _write_intact(log: Path, out: Path) -> None:
    """Write all messages that can be read of a log as a log with a proper end."""
    book, channels = LogReader(log), dict[str, int]()
    with out.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="airbearing-testbed, intact part of a log")
        for number, (topic, stamp, data) in enumerate(book.read(), 1):
            if topic not in channels:
                kind = book.kinds[topic]
                text = (book.texts[topic] or schema_text(kind)).encode()
                schema = writer.register_schema(ros_name(kind), "ros2msg", text)
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            at = book.epoch + stamp
            writer.add_message(channels[topic], at, data, at, number)
        writer.finish()
