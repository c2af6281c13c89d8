"""`testbed reproduce`: repeat the papers' simulations and check their claims."""

import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table as Grid
from rich.text import Text

from testbed.cli.exit_code import FAILED, INTERRUPTED, OK
from testbed.cli.refusal import errors, refuse
from testbed.cli.screen import print_json, print_text, show
from testbed.config import ConfigError
from testbed.report.chart import alone
from testbed.reproduction.audit import RunError, TaskResult, made, rows_of, tasks_of
from testbed.reproduction.claim import (
    CHECK,
    CORRECTED,
    FAILS,
    HOLDS,
    UNTESTABLE,
    ClaimRow,
    MeasureError,
    Paper,
    claimed,
    counts,
)
from testbed.reproduction.claim_page import Audited, write_pages
from testbed.reproduction.figure import Figure
from testbed.reproduction.page import page
from testbed.reproduction.paper import EVERY, chosen, read_papers
from testbed.reproduction.plot import chart_of

STYLES = {HOLDS: "green", CORRECTED: "cyan", FAILS: "red", UNTESTABLE: "yellow"}


def reproduce_papers(
    key: str, *, quick: bool, as_json: bool, as_markdown: bool, plots: Path | None,
    pages: Path | None = None,
) -> int:  # fmt: skip
    """Run the simulations and print the verdicts; return the exit code."""
    try:
        papers = read_papers(chosen(key))
        for folder, option in ((plots, "--plots"), (pages, "--pages")):
            if folder is not None:
                ready(folder, option)
        found, interrupted, wall = make_all(papers, quick=quick)
        audited = {
            name: rows_of(name, paper, found[name], quick=quick) for name, paper in papers.items()
        }
    except (ConfigError, MeasureError, RunError) as error:
        return refuse(error)
    rows = {name: rows for name, (rows, _) in audited.items()}
    missing = [one for _, lost in audited.values() for one in lost]
    if as_json:
        print_verdicts(rows, as_list=key == EVERY)
    elif as_markdown:
        sys.stdout.write("\n".join(page(name, papers[name], rows[name]) for name in papers))
    else:
        for name, paper in papers.items():
            print_table(name, paper, rows[name])
    surprises = [row for some in rows.values() for row in some if not row.as_expected]
    say_how_it_went(rows, surprises, missing, wall)
    if plots is not None:
        draw_all(plots, found)
    if pages is not None:
        index = write_pages(pages, {
            name: Audited(papers[name], rows[name], found[name], found.figures_of(name))
            for name in papers
        })  # fmt: skip
        errors.print(f"pages: {index}", markup=False, soft_wrap=True)
    if interrupted:
        return INTERRUPTED
    return FAILED if surprises else OK


class Results(dict[str, dict[str, Any]]):
    """Measured values by paper and run, and the finished runs with their figures."""

    def __init__(self, names: Mapping[str, Paper]) -> None:
        super().__init__({name: {} for name in names})
        self.made: list[TaskResult] = []

    def add(self, done: TaskResult) -> None:
        """Add the result of a finished run."""
        self[done.paper][done.run] = done.values
        self.made.append(done)

    def figures_of(self, paper: str) -> dict[str, list[Figure]]:
        """Figures of a paper by run."""
        return {done.run: done.figures for done in self.made if done.paper == paper}


def make_all(papers: Mapping[str, Paper], *, quick: bool) -> tuple[Results, bool, float]:
    """Make all runs; returns the results, whether interrupted, and the wall time [s]."""
    tasks, found = tasks_of(papers, quick=quick), Results(papers)
    began = time.perf_counter()
    progress = Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        console=errors, transient=True, disable=not errors.is_terminal,
    )  # fmt: skip
    interrupted = False
    try:
        with progress:
            bar = progress.add_task("runs (the first ones compile)", total=len(tasks))
            for done in made(tasks):
                found.add(done)
                progress.update(bar, advance=1, description=f"{done.paper} {done.run}")
    except KeyboardInterrupt:
        interrupted = True
    return found, interrupted, time.perf_counter() - began


def print_verdicts(rows: Mapping[str, list[ClaimRow]], *, as_list: bool) -> None:
    """Print one JSON object per paper; a list of objects for `all`."""
    papers = [
        {
            "paper": name,
            "counts": counts(some),
            "claims": [msgspec.to_builtins(row) | {"as_expected": row.as_expected} for row in some],
        }
        for name, some in rows.items()
    ]
    print_json(papers if as_list else papers[0])


def print_table(name: str, paper: Paper, rows: list[ClaimRow]) -> None:
    """Print the verdicts as a table."""
    grid = Grid(title=f"{name}: {paper.title}", title_justify="left", title_style="bold",
                show_lines=False, expand=True)  # fmt: skip
    grid.add_column("where", ratio=2)
    grid.add_column("claim", ratio=5)
    grid.add_column("paper", ratio=3)
    grid.add_column("measured", justify="right")
    grid.add_column("verdict", ratio=3)
    for row in rows:
        what = row.verdict if row.kind == CHECK else row.outcome
        mark = "" if row.as_expected else f" (expected: {row.expected})"
        grid.add_row(
            Text(row.source), Text(row.claim), Text(claimed(row)), Text(measured(row)),
            Text(what + mark, style=STYLES[row.outcome]),
        )  # fmt: skip
    show(Console(highlight=False), grid)


def measured(row: ClaimRow) -> str:
    """The measured value with its unit."""
    if row.measured is None:
        return "-" if row.outcome == UNTESTABLE else "never"
    return f"{row.measured:.4g} {row.unit}".strip()


def say_how_it_went(
    rows: Mapping[str, list[ClaimRow]], surprises: list[ClaimRow], missing: list[str], wall: float
) -> None:
    """Print the counts and each unexpected verdict on standard error."""
    every = [row for some in rows.values() for row in some]
    seeds = ", quick: fewer seeds, coarser steps" if any(row.quick for row in every) else ""
    print_text(errors, f"{counts(every)} (in {wall:.0f} s{seeds})")
    for row in surprises:
        print_text(
            errors,
            f'changed: {row.id}: expected "{row.expected}", found "{row.outcome}" '
            f"({measured(row)}, claimed {claimed(row)})",
            "red",
        )
    if missing:
        print_text(
            errors,
            f"interrupted: {len(missing)} claims were not reached: {', '.join(missing)}",
            "yellow",
        )


def ready(folder: Path, option: str) -> None:
    """Make the folder before the runs.

    Raises:
        ConfigError: the folder cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(option, "", "a folder", f"{folder}: {error.strerror}") from None


def draw_all(folder: Path, found: Results) -> None:
    """Write one SVG file per figure of each run."""
    for done in found.made:
        for figure in done.figures:
            key = f"{done.paper} {done.run} {figure.name}".replace(" ", "_").replace(",", "")
            chart = chart_of(key, f"{done.paper}, {done.run}", figure)
            (folder / f"{key}.svg").write_text(alone(chart), encoding="utf-8")
    errors.print(f"plots: {folder}", markup=False, soft_wrap=True)
