"""Reads a log's columns: CSV, also compressed, a MATLAB file, an MCAP file or a run of ours."""

import csv
import hashlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from testbed.identification.csv_log import read_csv, read_rows
from testbed.identification.refused import LogRefusedError as LogRefusedError
from testbed.identification.refused import NumericColumns as NumericColumns

Array = NDArray[np.float64]
LARGEST = 2_000_000_000  # size of a file [bytes]


def digest(path: Path) -> str:
    """SHA-256 of a file's bytes, in hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_columns(
    path: Path, wanted: Iterable[str] | None = None,
    chosen: Mapping[str, Sequence[float | str]] | None = None, topic: str | None = None,
) -> NumericColumns:  # fmt: skip
    """The columns of a log.

    Args:
        path: MATLAB (.mat), MCAP (.mcap, one table per topic), or else CSV, also compressed.
        wanted: the columns needed; None: all.
        chosen: only rows with one of these values in a column are read.
        topic: of an MCAP file; None: the only one with the columns.

    Raises:
        LogRefusedError: the file cannot be read or holds something else than numbers.
    """
    try:
        if not path.is_file():
            raise LogRefusedError(where=str(path), expected="a log", found="no such file")
        if path.stat().st_size > LARGEST:
            raise LogRefusedError(where=str(path), expected="at most 2 GB", found="a larger file")
        if path.suffix.lower() == ".mat":
            return NumericColumns(str(path), _chosen(_read_mat(path), chosen or {}))
        if path.suffix.lower() == ".mcap":
            found = _read_mcap(path, set(wanted or ()), topic)
            return NumericColumns(str(path), _chosen(found, chosen or {}))
        needed = None if wanted is None else set(wanted)
        return NumericColumns(str(path), read_csv(path, needed, chosen or {}))
    except (OSError, EOFError, UnicodeDecodeError, csv.Error, ValueError) as error:
        raise LogRefusedError(
            where=str(path), expected="a CSV, .mat or .mcap file", found=str(error)
        ) from None


def read_sources(path: Path, source: str, time: str, value: str) -> dict[str, Array]:
    """A CSV with one row per sample of several sources: (t, value) of each by its name.

    An empty value is NaN.

    Raises:
        LogRefusedError: it has other columns, or holds something else than numbers.
    """
    try:
        names, rows = read_rows(path, {time, value})
    except (OSError, EOFError, UnicodeDecodeError, csv.Error, ValueError) as error:
        raise LogRefusedError(where=str(path), expected="a CSV", found=str(error)) from None
    columns = NumericColumns(str(path), dict.fromkeys(names, np.zeros(0)))
    for name in (source, time, value):
        columns[name]  # refuses a missing one
    which, *numbers = (names.index(name) for name in (source, time, value))
    found: dict[str, list[tuple[float, float]]] = {}
    for number, row in rows:
        try:
            t, y = (float(row[k]) if row[k].strip() else np.nan for k in numbers)
        except ValueError as error:
            raise LogRefusedError(
                where=f"{path}, data row {number}",
                expected=f"numbers in the columns {time}, {value}", found=str(error),
            ) from None  # fmt: skip
        found.setdefault(row[which].strip(), []).append((t, y))
    return {name: np.array(samples) for name, samples in found.items()}


def _read_mat(path: Path) -> dict[str, Array]:
    from scipy.io import loadmat

    found: dict[str, Array] = {}

    def take(name: str, value: object) -> None:
        if isinstance(value, np.ndarray) and value.dtype.names:
            for field in value.dtype.names:
                take(f"{name}.{field}" if name else field, value[field].flat[0])
        elif isinstance(value, np.ndarray) and np.issubdtype(value.dtype, np.number):
            array = np.squeeze(np.asarray(value, dtype=float))
            if array.ndim == 1 and len(array) > 1:
                found[name] = array
            elif array.ndim == 2:
                table = array if array.shape[0] >= array.shape[1] else array.T
                found.update({f"{name}[{k + 1}]": table[:, k] for k in range(table.shape[1])})

    try:
        content = loadmat(str(path))
    except Exception as error:  # what scipy raises on a damaged file is not documented
        raise LogRefusedError(
            where=str(path), expected="a MATLAB file of version 4 to 7", found=str(error),
            hint="save version 7.3 again with -v7",
        ) from None  # fmt: skip
    for name, value in content.items():
        if not name.startswith("__"):
            take(name, value)
    return _same_length(found)


def _read_mcap(path: Path, wanted: set[str], topic: str | None) -> dict[str, Array]:
    """Numbers of the JSON messages of one topic, by dotted name."""
    import msgspec

    from testbed.logs.log_reader import LogReader

    topics: dict[str, list[dict[str, float]]] = {}
    for row in LogReader(path).read():
        cells = {"t_s": 1e-9 * row.stamp}
        try:
            _flatten("", msgspec.json.decode(row.data), cells)
        except msgspec.DecodeError:
            raise LogRefusedError(
                where=f"{path}, {row.topic}", expected="messages in JSON", found="another encoding",
                hint="a run of this project is given by its folder, without a mapping",
            ) from None  # fmt: skip
        topics.setdefault(row.topic, []).append(cells)
    if topic is not None and topic not in topics:
        found = f"the topics are: {', '.join(topics)}"
        raise LogRefusedError(where=str(path), expected=f"the topic {topic!r}", found=found)
    able = [name for name, rows in topics.items() if wanted <= rows[-1].keys()]
    if topic is None and len(able) > 1:
        raise LogRefusedError(
            where=str(path), expected="one topic with the columns of the mapping",
            found=", ".join(able), hint='name one in the mapping: topic = "..."',
        )  # fmt: skip
    if not topics:
        return {}
    rows = topics[topic or able[0]] if topic or able else max(topics.values(), key=len)
    names = dict.fromkeys(name for row in rows for name in row)
    return {n: np.array([row.get(n, np.nan) for row in rows]) for n in names}


def _chosen(
    columns: dict[str, Array], chosen: Mapping[str, Sequence[float | str]]
) -> dict[str, Array]:
    for name, values in chosen.items():
        kept = np.isin(NumericColumns("", columns)[name], [float(v) for v in values])
        columns = {other: column[kept] for other, column in columns.items()}
    return columns


def _flatten(name: str, value: object, cells: dict[str, float]) -> None:
    if isinstance(value, dict):
        for key, child in value.items():
            _flatten(f"{name}.{key}" if name else key, child, cells)
    elif isinstance(value, list):
        for k, child in enumerate(value):
            _flatten(f"{name}[{k + 1}]", child, cells)
    elif isinstance(value, bool | int | float):
        cells[name] = float(value)


def _same_length(columns: dict[str, Array]) -> dict[str, Array]:
    """The columns of the commonest length."""
    lengths = [len(c) for c in columns.values()]
    common = max(set(lengths), key=lengths.count, default=0)
    return {name: c for name, c in columns.items() if len(c) == common}
