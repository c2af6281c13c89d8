"""Reads a CSV as labs write it: compressed or not, with commas, semicolons or tabs."""

import csv
import gzip
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from testbed.identification.refused import LogRefusedError, NumericColumns

Array = NDArray[np.float64]
Row = tuple[int, list[str]]  # number of a data row, from 1, and its cells
GROUPED = re.compile(r"[-+]?\d{1,3}([,' ]\d{3})+(\.\d+)?|[-+]?\d+,\d+")
COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?|[-+]?\d+,")  # a number with a decimal comma
POINT = re.compile(r"[-+]?[\d,' ]*\.\d*([eE][-+]?\d+)?")  # a number with a decimal point
GZIP, ZIP, UTF_16 = b"\x1f\x8b", b"PK\x03\x04", (b"\xff\xfe", b"\xfe\xff")


def read_csv(
    path: Path, wanted: set[str] | None, chosen: Mapping[str, Sequence[float | str]]
) -> dict[str, Array]:
    """Columns of numbers; other columns are NaN, unless they are wanted.

    Args:
        path: of the file.
        wanted: columns that must hold numbers; None: all.
        chosen: only rows with one of these values in a column are read.
    """
    names, rows = read_rows(path, None if wanted is None else wanted.union(chosen))
    for name, values in chosen.items():
        if name not in names:
            NumericColumns(str(path), dict.fromkeys(names, np.zeros(0)))[name]
        rows = [row for row in rows if _is_one_of(row[1][names.index(name)].strip(), values)]
        if not rows:
            raise LogRefusedError(
                where=f"{path}, column {name!r}", expected=f"rows with one of {list(values)}",
                found="none", hint="see [rows] of the mapping",
            )  # fmt: skip
    return {
        name: _numbers(path, name, k, rows, must=wanted is None or name in wanted)
        for k, name in enumerate(names)
        if name
    }


def read_rows(path: Path, wanted: set[str] | None) -> tuple[list[str], list[Row]]:
    """Names of the columns, and the rows below; decimal commas of `wanted` columns are points.

    Raises:
        LogRefusedError: a row has another length, or two columns have one name.
    """
    lines = [line for line in _text(path).splitlines() if line.strip()]
    while lines and lines[0].startswith(("#", "%")):
        lines.pop(0)
    head = lines.pop(0) if lines else ""
    mark = max(",;\t", key=head.count)
    names = [name.strip() for name in next(csv.reader([head], delimiter=mark), [])]
    rows = list(enumerate((row for row in csv.reader(lines, delimiter=mark) if row), 1))
    if twice := sorted({n for n in names if names.count(n) > 1}):
        found = f"two columns {twice[0]!r}"
        raise LogRefusedError(where=str(path), expected="one column of each name", found=found)
    for number, row in rows:
        if len(row) != len(names):
            raise LogRefusedError(
                where=f"{path}, data row {number}",
                expected=f"{len(names)} values as in the head",
                found=f"{len(row)}",
                hint="a file cut off, or numbers with a comma inside (1,234 or 0,5)",
            )
    if mark != ",":
        _with_points(rows, [k for k, name in enumerate(names) if not wanted or name in wanted])
    return names, rows


def _with_points(rows: Sequence[Row], columns: Sequence[int]) -> None:
    """Decimal commas of these columns become points, if no number there has a point."""
    if any(POINT.fullmatch(cells[k].strip()) for _, cells in rows for k in columns):
        return
    for _, cells in rows:
        for k in columns:
            if COMMA.fullmatch(cells[k].strip()):
                cells[k] = cells[k].replace(",", ".")


def _text(path: Path) -> str:
    data = path.read_bytes()
    if data.startswith(GZIP):
        data = gzip.decompress(data)
    if data.startswith(UTF_16):
        return data.decode("utf-16")
    if data.startswith(ZIP) or b"\0" in data[:4096]:
        what = "a spreadsheet or a zip file: save it as CSV" if data.startswith(ZIP) else "binary"
        raise LogRefusedError(where=str(path), expected="a CSV, .mat or .mcap file", found=what)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")  # every byte is a letter


def _is_one_of(cell: str, values: Sequence[float | str]) -> bool:
    if cell in values:
        return True
    try:
        return float(cell) in values
    except ValueError:
        return False


def _numbers(path: Path, name: str, column: int, rows: Sequence[Row], *, must: bool) -> Array:
    values = np.empty(len(rows))
    for k, (number, cells) in enumerate(rows):
        cell = cells[column].strip()
        try:
            values[k] = float(cell) if cell else np.nan
        except ValueError:
            if not must:
                return np.full(len(rows), np.nan)
            hint = "if this is a row of units, delete it" if number == 1 else ""
            if GROUPED.fullmatch(cell):
                hint = "numbers with thousands separators or a decimal comma: write 1234.5"
            raise LogRefusedError(
                where=f"{path}, column {name!r}, data row {number}",
                expected="a number", found=repr(cell), hint=hint,
            ) from None  # fmt: skip
    return values
