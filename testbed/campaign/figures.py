"""The figures of a campaign: distributions, scatters, maps and success rates.

A run that passed is a disc, a failed run a cross. With several cases each has a colour and a mark,
hollow for failed runs.
"""

from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from testbed.report.axis import Axis, number, span, wants_log
from testbed.report.chart import LEFT, LETTER, RIGHT
from testbed.report.item import Box, Chart, Item, Key, Line, Mark, Words

WIDTH = 480
BINS = 24
HOLLOW = "hollow: did not pass"
SHARE = 0.55  # of a strip's height: its bars; the rest are its name and numbers
LONGEST = 24  # letters of a case's name beside a success rate


class Strip(Struct, frozen=True):
    """One case's row in a picture of distributions."""

    name: str
    passed: Sequence[float]
    others: Sequence[float]
    median: float | None  # None if no run has the number
    words: str


class RateRow(Struct, frozen=True):
    """A success rate with its interval, 0 to 1."""

    name: str
    low: float
    rate: float
    high: float
    words: str
    case: int | None = None  # index of its colour and mark


def histogram(passed: Sequence[float], others: Sequence[float], title: str) -> Chart:
    """A histogram; runs that did not pass are stacked on top."""
    axis = _along([*passed, *others])
    good, bad = counts(axis, passed), counts(axis, others)
    highest = max(g + b for g, b in zip(good, bad, strict=True))
    items = _bars(axis, good, bad)
    return _chart(f"distribution of {title}", (title, axis), "runs", items,
                  y_range=(0.0, 1.08 * highest), whole=True)  # fmt: skip


def strips(rows: Sequence[Strip], title: str) -> Chart:
    """Histograms below each other, with a common axis and scale."""
    axis = _along([value for row in rows for value in (*row.passed, *row.others)])
    found = [(counts(axis, row.passed), counts(axis, row.others)) for row in rows]
    highest = max(g + b for good, bad in found for g, b in zip(good, bad, strict=True))
    items: list[Item] = []
    labels: list[tuple[float, str]] = []
    for k, (row, (good, bad)) in enumerate(zip(rows, found, strict=True)):
        base, case = float(len(rows) - 1 - k), k
        ends = np.array([axis.low, axis.high])
        items.append(Line(ends, np.full(2, base), 0, "", "base"))
        labels += [(base, "0"), (base + SHARE, str(highest))]
        items += _bars(axis, good, bad, case, base, SHARE / highest)
        if row.median is not None:
            x, y = np.full(2, row.median), base + np.array([-0.05, SHARE + 0.05])
            items.append(Line(x, y, 0, "", "median"))
        top = base + 0.72
        room = WIDTH - LEFT - RIGHT - 26 - LETTER * len(row.words)
        name = cut(row.name, int(room / LETTER))
        items.append(Mark(axis.low, top + 0.07, case=case, style="full", radius=4.0, shift=5.0))
        items.append(Words(axis.low, top, name, "start", "name", 14.0))
        items.append(Words(axis.high, top, row.words, "end"))
    return _chart(f"distribution of {title} by case", (title, axis), "runs", items,
                  y_range=(-0.08, float(len(rows))), y_ticks=labels,
                  height=round(56 * len(rows)))  # fmt: skip


def scatter(
    marks: Sequence[Mark],
    x_title: str,
    y_title: str,
    fronts: Sequence[Sequence[Mark]] = (),
    names: Sequence[str] = (),
) -> Chart:
    """Scatter plot of runs, by case if `names` are given, with fronts as steps."""
    xs, ys = [p.x for p in marks], [p.y for p in marks]
    x_log, y_log = wants_log(xs), wants_log(ys)
    items: list[Item] = [Key(name, k) for k, name in enumerate(names)]
    if names and any(not p.passed for p in marks):
        items.append(Key(HOLLOW, None))
    items += marks
    for front in fronts:
        x = np.repeat([p.x for p in front], 2)[1:]
        y = np.repeat([p.y for p in front], 2)[:-1]
        items.append(Line(x, y, front[0].case or 0, "", "" if names else "front"))
        items += [Mark(p.x, p.y, p.hint, True, p.case, "best", 4.5) for p in front]
    (low, high), y_range = span(xs, x_log), span(ys, y_log)
    axis = Axis(low, high, 0.0, 1.0, x_log)
    title = f"{y_title}, log scale" if y_log else y_title
    return _chart(f"{y_title} against {x_title}", (x_title, axis), title, items,
                  y_range=y_range, log=y_log)  # fmt: skip


def heat(
    cells: Sequence[Box], columns: Sequence[str], rows: Sequence[str], x_title: str, y_title: str
) -> Chart:
    """A heat map; its cells have the width and height 1."""
    axis = Axis(0.0, float(len(columns)), 0.0, 1.0)
    return _chart(f"{y_title} by {x_title}", (x_title, axis), y_title, cells,
                  y_range=(0.0, float(len(rows))),
                  x_ticks=[(k + 0.5, name) for k, name in enumerate(columns)],
                  y_ticks=[(k + 0.5, name) for k, name in enumerate(rows)])  # fmt: skip


def success_rates(rows: Sequence[RateRow]) -> Chart:
    """Success rates with intervals, from 0 to 100 %."""
    items: list[Item] = []
    heights = [len(rows) - k - 0.5 for k in range(len(rows))]
    cases = any(row.case is not None for row in rows)
    for row, y in zip(rows, heights, strict=True):
        ends = 100.0 * np.array([row.low, row.high])
        look = "wide" if row.case is not None else "wide rest" if cases else "wide interval"
        items.append(Line(ends, np.full(2, y), row.case or 0, "", look))
        style = "full" if row.case is not None or not cases else "rest"
        items.append(Mark(100.0 * row.rate, y, case=row.case, style=style, radius=4.5))
    return _chart("success rate with interval", ("passed [%]", Axis(0.0, 100.0, 0.0, 1.0)), "",
                  items, y_range=(0.0, float(len(rows))), height=26 * len(rows),
                  y_ticks=[(y, cut(r.name, LONGEST)) for r, y in zip(rows, heights, strict=True)],
                  side=[(y, r.words) for r, y in zip(rows, heights, strict=True)])  # fmt: skip


def counts(axis: Axis, values: Sequence[float]) -> list[int]:
    """Number of values in each bin."""
    found = [0] * BINS
    for value in values:
        found[min(BINS - 1, max(0, int(axis.share(value) * BINS)))] += 1
    return found


def cut(words: str, most: int) -> str:
    """The text, truncated to `most` characters."""
    return words if len(words) <= most else words[: max(1, most - 1)] + "\N{HORIZONTAL ELLIPSIS}"


def _chart(
    title: str, along: tuple[str, Axis], y_title: str, items: Sequence[Item], **more: object
) -> Chart:
    name, axis = along
    words = f"{name}, log scale" if axis.log else name
    return Chart("", title, words, y_title, items, (axis.low, axis.high),
                 x_log=axis.log, width=WIDTH, **more)  # type: ignore[arg-type]  # fmt: skip


def _along(values: Sequence[float]) -> Axis:
    """The horizontal axis of a histogram, without margins."""
    log = wants_log(values)
    return Axis(*span(values, log, 0.0), 0.0, 1.0, log)


def _bars(
    axis: Axis, good: Sequence[int], bad: Sequence[int],
    case: int | None = None, base: float = 0.0, per: float = 1.0,
) -> list[Item]:  # fmt: skip
    """Bars of the passed runs, with the others stacked on top; `per` is the height of one run."""
    looks = ("good", "bad") if case is None else ("full", "open")
    bars: list[Item] = []
    for k, (g, b) in enumerate(zip(good, bad, strict=True)):
        x = axis.value(k / BINS), axis.value((k + 1) / BINS)
        hint = f"{number(x[0])} to {number(x[1])}: {g} passed, {b} not"
        for look, low, high in zip(looks, (0, g), (g, g + b), strict=True):
            if high > low:
                bars.append(Box(x, (base + low * per, base + high * per), look, hint, case))
    return bars
