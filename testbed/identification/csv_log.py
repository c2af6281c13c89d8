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
CLOCK = re.compile(r"\d{1,4}[-/.:]\d{1,2}[-/.:]\d{1,4}.*")  # a date or a time of day
MISSING = {"", "na", "n/a", "#n/a", "null", "none", "-", "--"}  # besides nan
TRUTHS = {"true": 1.0, "false": 0.0}
TOP = 60  # lines in which the names of the columns are looked for
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
    if wanted and not chosen and (plain := _plain(path, wanted)):
        return plain
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


def _plain(path: Path, wanted: set[str]) -> dict[str, Array] | None:
    """Columns of a file of plain numbers, read in one go; None: it needs a closer look."""
    lines = _lines(path)
    above, mark, names = _head(lines, wanted) if lines else (0, ",", [])
    rows = lines[above + 1 :]
    if not rows or any(names.count(name) != 1 for name in wanted):
        return None
    if any(row.count(mark) != len(names) - 1 for row in rows):
        return None
    if mark != "," and not any("." in row for row in rows):
        rows = [row.replace(",", ".") for row in rows]
    columns = [k for k, name in enumerate(names) if name in wanted]
    try:
        table = np.loadtxt(rows, delimiter=mark, comments=None, usecols=columns, ndmin=2)
    except ValueError:
        return None
    nothing = np.full(len(rows), np.nan)
    found = dict.fromkeys(filter(None, names), nothing)
    return found | {names[k]: table[:, i].copy() for i, k in enumerate(columns)}


def read_rows(path: Path, wanted: set[str] | None) -> tuple[list[str], list[Row]]:
    """Names of the columns, and the rows below; decimal commas of `wanted` columns are points.

    Raises:
        LogRefusedError: a row has another length, or two columns have one name.
    """
    lines = _lines(path)
    if not lines:
        raise LogRefusedError(where=str(path), expected="names and numbers", found="an empty file")
    above, mark, names = _head(lines, wanted)
    if len(names) == 1 and wanted and len(wanted) > 1:
        raise LogRefusedError(
            where=str(path), expected="values with commas, semicolons or tabs between them",
            found=repr(lines[above][:60]), hint="save it as CSV",
        )  # fmt: skip
    found = csv.reader(lines[above + 1 :], delimiter=mark, skipinitialspace=True)
    rows = [(k, row) for k, row in enumerate(found, 1) if any(map(str.strip, row))]
    twice = sorted({n for n in names if n and names.count(n) > 1 and (not wanted or n in wanted)})
    if twice:
        raise LogRefusedError(
            where=str(path), expected="one column of each name", found=f"two columns {twice[0]!r}",
            hint="give each column a name of its own, in the file and in the mapping",
        )  # fmt: skip
    for number, row in rows:
        while len(row) > len(names) and not row[-1].strip():
            row.pop()
        if len(row) != len(names):
            hint = "a file cut off, a note, or numbers with a comma inside (1,234 or 0,5)"
            if number == 1:
                hint = "delete the lines above the names of the columns, or begin them with #"
            raise LogRefusedError(
                where=f"{path}, data row {number}",
                expected=f"{len(names)} values as in the head", found=f"{len(row)}", hint=hint,
            )  # fmt: skip
    if mark != ",":
        _with_points(rows, [k for k, name in enumerate(names) if not wanted or name in wanted])
    return names, rows


def _lines(path: Path) -> list[str]:
    """Lines of a file without empty ones, and without notes at its top."""
    lines = [line for line in _text(path).splitlines() if line.strip()]
    notes = (k for k, line in enumerate(lines) if not line.startswith(("#", "%")))
    return lines[next(notes, len(lines)) :]


def _head(lines: Sequence[str], wanted: set[str] | None) -> tuple[int, str, list[str]]:
    """Number of the line with the names, what separates them, and the names.

    Exports of motion capture have lines of notes above: the names are those that are wanted. Where
    no line has them, the first one counts.
    """
    found = [_split(line) for line in lines[:TOP]]
    k = next((k for k, (_, names) in enumerate(found) if wanted and wanted.issubset(names)), 0)
    return k, *found[k]


def _split(line: str) -> tuple[str, list[str]]:
    """What separates the cells of a line, and the cells."""
    mark = max(",;\t", key=line.count)
    cells = next(csv.reader([line], delimiter=mark, skipinitialspace=True), [])
    return mark, [cell.strip() for cell in cells]


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
    if data[:64] and not any(data[1:64:2]):  # without a mark, and the names are ASCII
        return data.decode("utf-16-le")
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
            if cell.lower() in MISSING:
                values[k] = np.nan
            elif cell.lower() in TRUTHS:
                values[k] = TRUTHS[cell.lower()]
            elif not must:
                return np.full(len(rows), np.nan)
            else:
                raise LogRefusedError(
                    where=f"{path}, column {name!r}, data row {number}", expected="a number",
                    found=repr(cell), hint=_advice(cell, number),
                ) from None  # fmt: skip
    return values


def _advice(cell: str, number: int) -> str:
    """What to do about a cell that is no number."""
    if CLOCK.fullmatch(cell):
        return "a date or a time of day: write seconds since any start, with all digits"
    if GROUPED.fullmatch(cell) or (cell[:1].isdigit() and "," in cell):
        return "numbers with thousands separators or a decimal comma: write 1234.5"
    return "if this is a row of units, delete it" if number == 1 else "leave a missing pose empty"
