"""What a paper prints about a table experiment, beside its runs: values, points, residuals."""

from collections.abc import Callable, Sequence
from html import escape
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from testbed.config import ConfigError
from testbed.logs.history import History
from testbed.report.chart import TIME
from testbed.report.item import Chart, Item, Line, Mark, Moment
from testbed.reproduction.claim import Claim, Points
from testbed.reproduction.paper import keys, read_papers
from testbed.reproduction.paper_numbers import DIAMOND, SIGNS
from testbed.reproduction.table import TableRun

AT_A_TIME = {"settle_s": "error"}  # measures that are a time, and the figure that shows it
NEAREST = "trajectory"  # figure whose points are places: the residual is the distance of the paths


class Printed(NamedTuple):
    """What one paper prints about one experiment."""

    key: str
    claims: Sequence[Claim]  # with a number
    points: Sequence[Points]


class PaperRow(NamedTuple):
    """One number of the paper, and the runs' values."""

    source: str
    what: str
    paper: str
    values: Sequence[str]  # one per run, with the difference to the paper


def printed_about(experiment: str) -> Printed:
    """The paper's numbers.

    Raises:
        ConfigError: there are none.
    """
    key = experiment.partition("_")[0]
    if key in keys():
        paper = read_papers([key])[key]
        runs = {
            name
            for name, run in paper.runs.items()
            if isinstance(run, TableRun) and run.experiment == experiment
        }
        claims = [
            claim
            for claim in paper.claims
            if claim.run in runs and claim.over is None and not isinstance(claim.paper, str)
        ]
        points = [one for one in paper.points if one.experiment == experiment]
        if claims or points:
            return Printed(key, claims, points)
    found = f"{experiment}, about which no file of configs/papers has a number"
    expected = "runs of a paper's table experiment; `[[points]]` of its file adds numbers"
    raise ConfigError("--paper", "", expected, found)


def paper_rows(
    printed: Printed, values: Sequence[Callable[[str], float | None]], paths: Sequence[History]
) -> list[PaperRow]:
    """Claims and points, with a column per run."""
    rows = [
        PaperRow(c.source, c.claim, f"{SIGNS[c.must]}{c.paper:g} {c.unit}".rstrip(),
                 [_beside(value(str(c.measure)), float(c.paper)) for value in values])
        for c in printed.claims
    ]  # fmt: skip
    for one in printed.points:
        if one.figure == NEAREST:
            for k, (x, y) in enumerate(zip(one.x, one.y, strict=True), 1):
                near = [_nearest(path, x, y) for path in paths]
                words = [f"{1e3 * off:.1f} mm from the path" for off in near]
                where = f"{one.source}, {one.what} {k}"
                rows.append(PaperRow(where, one.what, f"({x:g}, {y:g}) m", words))
    return rows


def _beside(value: float | None, paper: float) -> str:
    return "-" if value is None else f"{value:.4g} ({value - paper:+.3g})"


def _nearest(path: History, x: float, y: float) -> float:
    """Distance of a place from the nearest vehicle's path [m]."""
    ways = [path.where(name)[1][:, :2] for name in path.vehicles]
    return min((float(np.hypot(*(way - (x, y)).T).min()) for way in ways if len(way)),
               default=np.nan)  # fmt: skip


def with_paper(charts: Sequence[Chart], printed: Printed) -> list[Chart]:
    """The figures with the paper's points, times, and residuals of curves over time."""
    found = []
    for chart in charts:
        items: list[Item] = []
        residuals: list[Line] = []
        for one in printed.points:
            if one.figure == chart.key:
                items += _marks(one)
                residuals += _residuals(chart, one)
        for claim in printed.claims:
            if AT_A_TIME.get(str(claim.measure)) == chart.key:
                items.append(
                    Moment(float(claim.paper), f"{printed.key}: {claim.paper:g} s", "mild")
                )
        note = f"{chart.note} Black diamonds: {printed.key}.".strip() if items else chart.note
        found.append(replace(chart, items=[*chart.items, *items], note=note))
        if residuals:
            title = f"Residual: {chart.title}, less that of {printed.key}"
            found.append(Chart(f"{chart.key}_paper", title, TIME, chart.y_label, residuals,
                               chart.x_range))  # fmt: skip
    return found


def _marks(one: Points) -> list[Mark]:
    text = f"{one.source}: {one.what}"
    return [Mark(x, y, f"{text}, ({x:g}, {y:g})", case=DIAMOND, style="paper", radius=6)
            for x, y in zip(one.x, one.y, strict=True)]  # fmt: skip


def _residuals(chart: Chart, one: Points) -> list[Line]:
    """Each run's curves less the paper's points, at the paper's times."""
    if chart.x_label != TIME:
        return []
    x, y = np.array(one.x), np.array(one.y)
    found = []
    for line in chart.items:
        if isinstance(line, Line) and len(line.x) > 1:
            inside = (x >= line.x[0]) & (x <= line.x[-1])
            off = np.interp(x[inside], line.x, line.y) - y[inside]
            found.append(replace(line, x=x[inside], y=off))
    return found


def paper_table(printed: Printed, labels: Sequence[str], rows: Sequence[PaperRow]) -> str:
    """The rows as HTML."""
    heads = "".join(f"<th>{escape(label)}</th>" for label in labels)
    body = "".join(
        f'<tr><td>{escape(row.source)}</td><td class="words">{escape(row.what)}</td>'
        f"<td>{escape(row.paper)}</td>{''.join(f'<td>{escape(v)}</td>' for v in row.values)}</tr>"
        for row in rows
    )
    return (
        f"<h2>Beside {printed.key}</h2><p>What the paper prints about this experiment; in brackets "
        "the run's value less the paper's. Its curves are pictures without numbers.</p>"
        f'<div class="wide"><table><tr><th>where</th><th class="words">what</th><th>paper</th>'
        f"{heads}</tr>{body}</table></div>"
    )
