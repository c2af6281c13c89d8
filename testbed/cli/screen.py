"""Prints tables and sentences so that no name and no number is cut, however wide the terminal is.

Text folds inside its column. Numbers, which are aligned to the right, stay on one line: if they do
not fit beside each other, the table is printed in parts, each with the first column.
"""

import os
import sys
import textwrap
from collections.abc import Sequence

import msgspec
from rich.console import Console
from rich.table import Column
from rich.table import Table as Grid

WIDEST = 10_000  # of a file or a pipe, which has no width [characters]
LEAST_TEXT = 28  # width that a longer text keeps at least [characters]


def print_json(result: object) -> None:
    """Print a result as JSON on standard output."""
    sys.stdout.write(msgspec.json.format(msgspec.json.encode(result), indent=2).decode() + "\n")


def show(out: Console, grid: Grid, *, keeps_last: bool = False) -> None:
    """Print a table; with `keeps_last`, each part has the last column, too."""
    if not out.is_terminal and "COLUMNS" not in os.environ:
        out.width, grid.expand = WIDEST, False
    for column in grid.columns:
        column.overflow, column.no_wrap = "fold", column.justify == "right"
    first, *others = grid.columns
    last = [others.pop()] if keeps_last and len(others) > 1 else []
    parts: list[list[Column]] = []
    for column in others:
        if not parts or _width(out, grid, [first, *parts[-1], column, *last]) > out.width:
            parts.append([])
        parts[-1].append(column)
    if len(parts) < 2:
        out.print(grid)
        return
    for k, some in enumerate(parts):
        out.print(_part(grid, [first, *some, *last], is_first=k == 0))


def print_text(out: Console, text: str, style: str | None = None, hang: int = 2) -> None:
    """Print a sentence; on a terminal it folds between words, `hang` further in than it begins."""
    if out.is_terminal:
        begins = " " * (len(text) - len(text.lstrip()))
        text = textwrap.fill(
            text.lstrip(), out.width, initial_indent=begins, subsequent_indent=begins + hang * " ",
            break_long_words=False, break_on_hyphens=False,
        )  # fmt: skip
    out.print(text, style=style, markup=False, soft_wrap=True)


def _width(out: Console, grid: Grid, columns: Sequence[Column]) -> int:
    """Least width of a table of these columns."""
    beside = grid.padding[1] + grid.padding[3] + (grid.box is not None)
    return sum(beside + _least(out, column) for column in columns) + (grid.box is not None)


def _least(out: Console, column: Column) -> int:
    options = out.options.update(width=WIDEST)
    natural = max(
        out.measure(cell, options=options).maximum for cell in (column.header, *column.cells)
    )
    return natural if column.justify == "right" else min(natural, LEAST_TEXT)


def _part(grid: Grid, columns: Sequence[Column], *, is_first: bool) -> Grid:
    part = Grid(
        title=grid.title if is_first else None, title_justify=grid.title_justify,
        title_style=grid.title_style, box=grid.box, pad_edge=grid.pad_edge, padding=grid.padding,
        show_header=grid.show_header,
    )  # fmt: skip
    for one in columns:
        part.add_column(
            one.header, style=one.style, justify=one.justify, overflow="fold", no_wrap=one.no_wrap
        )
    for row, cells in zip(grid.rows, zip(*(one.cells for one in columns), strict=True),
                          strict=True):  # fmt: skip
        part.add_row(*cells, style=row.style, end_section=row.end_section)
    return part
