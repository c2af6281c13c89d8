"""A log as tables: one per topic, one row per message, one column per number.

Units are SI and radians, times seconds of the run, where a name does not say otherwise (`on_us`).
Nested fields are joined with dots (`outputs.state.pose.x`), lists of up to LISTED numbers become
`name[0]`, `name[1]`, ...; longer and uneven lists stay JSON text. Times are `t` [s]. A number that
is not there is nan, a word that is not there is empty.
"""

import csv
import errno
import json
import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.error import TestbedError
from testbed.core.extra import pip_install
from testbed.files import atomic_write
from testbed.logs.defaults import KINDS, complete
from testbed.logs.log_reader import UNREADABLE, LogError, Row

LISTED = 16
UNITS = "SI and radians, times in seconds of the run, where a name does not say otherwise (on_us)"
NO_NUMBERS = {"nan", "inf", "-inf"}  # spelled out in the log, because JSON has none of them

Table = dict[str, NDArray[Any]]


class ExportError(TestbedError):
    """It cannot be written."""


def tables(rows: Iterable[Row], kinds: Mapping[str, str] | None = None) -> dict[str, Table]:
    """Every topic as a table of columns of equal length.

    Args:
        rows: of a log.
        kinds: name of each topic's schema, known when its first row is (`LogReader.kinds`).
    """
    flat: dict[str, list[dict[str, Any]]] = {}
    for topic, stamp, data in rows:
        row: dict[str, Any] = {"t": stamp * 1e-9}
        try:
            message = json.loads(data)
            if kinds is not None and (kind := KINDS.get(kinds.get(topic, ""))) is not None:
                message = complete(kind, message)
            _flatten("", message, row)
        except UNREADABLE as error:
            raise LogError(f"{topic} at {stamp * 1e-9:.3f} s: {error}") from None
        flat.setdefault(topic, []).append(row)
    if not flat:
        raise LogError("there are no messages in the log")
    return {topic: _columns(found) for topic, found in flat.items()}


def _flatten(path: str, value: Any, row: dict[str, Any]) -> None:
    match value:
        case dict():
            for key, inner in value.items():
                _flatten(f"{path}.{key}" if path else key, inner, row)
        case list() if 0 < len(value) <= LISTED and all(
            isinstance(v, int | float) for v in value
        ):  # fmt: skip
            for k, inner in enumerate(value):
                row[f"{path}[{k}]"] = inner
        case list():
            row[path] = json.dumps(value)
        case _ if path != "t":
            row[path] = value


def _columns(rows: list[dict[str, Any]]) -> Table:
    names = dict.fromkeys(name for row in rows for name in row)
    deep = {name.rpartition(".")[0] for name in names}
    names = dict.fromkeys(n for n in names if n not in deep)  # null where it is not a structure
    return {name: _column([row.get(name) for row in rows]) for name in names}


def _column(values: list[Any]) -> NDArray[Any]:
    given = [v for v in values if v is not None]
    if all(isinstance(v, bool) for v in given) and len(given) == len(values):
        return np.array(values, dtype=bool)
    with suppress(OverflowError):  # a number that is larger than any: it stays text
        if all(isinstance(v, int) for v in given) and len(given) == len(values):
            return np.array(values, dtype=np.int64)
        if all(isinstance(v, int | float) or v in NO_NUMBERS for v in given):
            return np.array([np.nan if v is None else float(v) for v in values])
    return np.array(["" if v is None else str(v) for v in values])


def _names(found: Mapping[str, Table], folder: Path, ending: str) -> dict[str, Path]:
    """A new file for each topic.

    Raises:
        FileExistsError: one of them is there, before any is written.
    """
    paths = {t: folder / f"{t.strip('/').replace('/', '_')}.{ending}" for t in found}
    for path in paths.values():
        refuse_older(path)
    return paths


def refuse_older(path: Path) -> None:
    """Nothing is written over."""
    if path.exists():
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))


def to_csv(found: dict[str, Table], folder: Path) -> list[Path]:
    """One file per topic."""
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
    """One file; names are `sat1/tick/outputs.state.pose.x`."""
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
    """One file per topic; needs pyarrow."""
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


WRITERS: dict[str, Callable[[dict[str, Table], Path], list[Path]]] = {
    "csv": to_csv, "npz": to_npz, "parquet": to_parquet,
}  # fmt: skip
