"""Reads a log's columns: CSV, also compressed, a MATLAB file, an MCAP file or a run of ours."""

import csv
import gzip
import hashlib
import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from testbed.core.error import TestbedError
from testbed.core.spelling import did_you_mean

Array = NDArray[np.float64]
LARGEST = 2_000_000_000  # size of a file [bytes]
GROUPED = re.compile(r"[-+]?\d{1,3}([,' ]\d{3})+(\.\d+)?|[-+]?\d+,\d+")


class LogRefusedError(TestbedError):
    """The log cannot be used; the message names the suspected reason."""


class NumericColumns(dict[str, Array]):
    """Numeric columns of equal length; a missing one is refused with its name."""

    def __init__(self, where: str, columns: dict[str, Array]) -> None:
        super().__init__(columns)
        self.where = where

    def __missing__(self, name: str) -> Array:
        raise LogRefusedError(
            where=self.where,
            expected=f"a column {name!r}, which the mapping names",
            found=f"no such column{did_you_mean(name, list(self))}",
            hint=f"the columns are: {', '.join(self)}",
        )

    def whole(self, name: str) -> Array:
        """A column; a missing value is refused."""
        values = self[name]
        if (bad := int(np.sum(~np.isfinite(values)))) > 0:
            row = int(np.argmin(np.isfinite(values))) + 1
            raise LogRefusedError(
                where=self.where,
                expected=f"a number in every row of {name!r}",
                found=f"{bad} rows without one, the first is data row {row}",
            )
        return values


def digest(path: Path) -> str:
    """SHA-256 of a file's bytes, in hex."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def read_columns(path: Path, wanted: Iterable[str] | None = None) -> NumericColumns:
    """The columns of a log.

    Args:
        path: CSV (.csv, .csv.gz), MATLAB (.mat) or MCAP (.mcap, one table per topic).
        wanted: the columns needed; None: all.

    Raises:
        LogRefusedError: the file cannot be read or holds something else than numbers.
    """
    try:
        if not path.is_file():
            raise LogRefusedError(where=str(path), expected="a log", found="no such file")
        if path.stat().st_size > LARGEST:
            raise LogRefusedError(where=str(path), expected="at most 2 GB", found="a larger file")
        if path.suffix == ".mat":
            return NumericColumns(str(path), _read_mat(path))
        if path.suffix == ".mcap":
            return NumericColumns(str(path), _read_mcap(path))
        return NumericColumns(str(path), _read_csv(path, None if wanted is None else set(wanted)))
    except (OSError, EOFError, UnicodeDecodeError, csv.Error, ValueError) as error:
        raise LogRefusedError(
            where=str(path), expected="a CSV, .mat or .mcap file", found=str(error)
        ) from None


def read_sources(path: Path, source: str, time: str, value: str) -> dict[str, Array]:
    """A CSV with one row per sample of several sources: (t, value) of each by its name.

    Raises:
        LogRefusedError: it has other columns, or holds something else than numbers.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise LogRefusedError(where=str(path), expected="a CSV", found=str(error)) from None
    found: dict[str, list[tuple[float, float]]] = {}
    for number, row in enumerate(rows, 1):
        try:
            found.setdefault(row[source], []).append((float(row[time]), float(row[value])))
        except (KeyError, TypeError, ValueError) as error:
            raise LogRefusedError(
                where=f"{path}, data row {number}",
                expected=f"columns {source}, {time}, {value}; the last two are numbers",
                found=str(error),
            ) from None
    return {name: np.array(samples) for name, samples in found.items()}


def _read_csv(path: Path, wanted: set[str] | None) -> dict[str, Array]:
    opened = gzip.open if path.suffix == ".gz" else open
    with opened(path, "rt", encoding="utf-8-sig", newline="") as file:
        head = file.readline()
        mark = ";" if head.count(";") > head.count(",") else ","
        names = [name.strip() for name in next(csv.reader([head], delimiter=mark), [])]
        rows = [row for row in csv.reader(file, delimiter=mark) if row]
    if twice := sorted({n for n in names if names.count(n) > 1}):
        found = f"two columns {twice[0]!r}"
        raise LogRefusedError(where=str(path), expected="one column of each name", found=found)
    for number, row in enumerate(rows, 1):
        if len(row) != len(names):
            raise LogRefusedError(
                where=f"{path}, data row {number}",
                expected=f"{len(names)} values as in the head",
                found=f"{len(row)}",
                hint="a file cut off, or numbers with a comma inside (1,234 or 0,5)",
            )
    return {
        name: _numbers(path, name, [row[k] for row in rows], must=wanted is None or name in wanted)
        for k, name in enumerate(names)
        if name
    }


def _numbers(path: Path, name: str, cells: list[str], *, must: bool) -> Array:
    values = np.empty(len(cells))
    for k, cell in enumerate(cells):
        try:
            values[k] = float(cell) if cell.strip() else np.nan
        except ValueError:
            if not must:
                return np.full(len(cells), np.nan)
            hint = "numbers with thousands separators or a decimal comma"
            raise LogRefusedError(
                where=f"{path}, column {name!r}, data row {k + 1}",
                expected="a number",
                found=repr(cell),
                hint=f"{hint}: write 1234.5" if GROUPED.fullmatch(cell.strip()) else "",
            ) from None
    return values


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


def _read_mcap(path: Path) -> dict[str, Array]:
    """Numbers of JSON messages of the topic with the most messages, by dotted name."""
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
    if not topics:
        return {}
    rows = max(topics.values(), key=len)
    names = dict.fromkeys(name for row in rows for name in row)
    return {n: np.array([row.get(n, np.nan) for row in rows]) for n in names}


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
