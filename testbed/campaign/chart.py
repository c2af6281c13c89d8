"""Charts as SVG text, in the colours of the surrounding page.

One font size, thin axes, a faint grid. A run that passed is a disc, a failed run a cross. With
several cases each has a colour and a mark, hollow for failed runs, so that colour is never the only
cue.
"""

from collections.abc import Sequence
from html import escape
from typing import NamedTuple

from testbed.campaign.axis import Axis, log_span, number, span, wants_log

WIDTH, HEIGHT = 420.0, 260.0
LEFT, RIGHT, TOP, BOTTOM = 66.0, 12.0, 14.0, 42.0
LETTER, LINE, STRIP = 6.2, 18.0, 50.0  # width of one, height of a line of a legend, of a strip
BINS = 24
END = 'text-anchor="end"'
GOOD_BAD = ("good", "bad")
HOLLOW = "hollow: did not pass"

# Corners of the cases' marks about their centre, in radii of the disc, which is the first.
MARKS: tuple[tuple[tuple[float, float], ...], ...] = (
    (),
    ((-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)),
    ((0.0, -1.25), (1.2, 0.9), (-1.2, 0.9)),
    ((0.0, -1.4), (1.1, 0.0), (0.0, 1.4), (-1.1, 0.0)),
    ((0.0, 1.25), (1.2, -0.9), (-1.2, -0.9)),
    ((-0.4, -1.3), (0.4, -1.3), (0.4, -0.4), (1.3, -0.4), (1.3, 0.4), (0.4, 0.4),
     (0.4, 1.3), (-0.4, 1.3), (-0.4, 0.4), (-1.3, 0.4), (-1.3, -0.4), (-0.4, -0.4)),
)  # fmt: skip


class Point(NamedTuple):
    """One run in a scatter."""

    x: float
    y: float
    passed: bool
    hint: str
    case: int = 0  # index of colour and mark if there are several cases


def wide(low: float, high: float, title: str, log: bool = False) -> Axis:
    """The axis along the bottom."""
    return Axis(low, high, LEFT, WIDTH - RIGHT, title, log)


def tall(low: float, high: float, title: str, log: bool = False) -> Axis:
    """The axis up the left side."""
    return Axis(low, high, HEIGHT - BOTTOM, TOP, title, log)


def page(parts: Sequence[str], label: str, height: float = HEIGHT) -> str:
    """The whole picture."""
    return (
        f'<svg viewBox="0 0 {WIDTH:g} {height:g}" role="img" aria-label="{escape(label)}">'
        f"{''.join(parts)}</svg>"
    )


def text(x: float, y: float, words: str, kind: str = "label", extra: str = "") -> str:
    """A text element."""
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}" {extra}>{escape(words)}</text>'


def frame(x: Axis, y: Axis, x_ticks: bool = True, y_ticks: bool = True) -> list[str]:
    """Grid, numbers and titles."""
    parts = []
    for value, words in y.labels() if y_ticks else ():
        at = y.at(value)
        parts.append(f'<path class="grid" d="M{x.start:g} {at:.1f}H{x.end:g}"/>')
        parts.append(text(x.start - 7, at + 3.5, words, "tick", END))
    for value, words in x.labels() if x_ticks else ():
        at = x.at(value)
        parts.append(f'<path class="grid" d="M{at:.1f} {y.start:g}V{y.end:g}"/>')
        parts.append(text(at, y.start + 15, words, "tick", 'text-anchor="middle"'))
    parts.append(f'<path class="axis" d="M{x.start:g} {y.start:g}H{x.end:g}"/>')
    middle = 0.5 * (x.start + x.end)
    parts.append(text(middle, y.start + 33, x.words, "label", 'text-anchor="middle"'))
    if y.title:
        up = 0.5 * (y.start + y.end)
        turned = f'text-anchor="middle" transform="rotate(-90 13 {up:g})"'
        parts.append(text(13, up, y.words, "label", turned))
    return parts


def histogram(passed: Sequence[float], others: Sequence[float], title: str) -> str:
    """A histogram; runs that did not pass are stacked on top."""
    x = along([*passed, *others], title)
    good, bad = counts(x, passed), counts(x, others)
    highest = max(g + b for g, b in zip(good, bad, strict=True))
    y = tall(0.0, 1.08 * highest, "runs")._replace(whole=True)
    return page([*frame(x, y), *bars(x, y, good, bad)], f"distribution of {title}")


def along(values: Sequence[float], title: str) -> Axis:
    """The horizontal axis of a histogram, without margins."""
    log = wants_log(values)
    return wide(*(log_span(values, 0.0) if log else span(values, 0.0)), title, log)


def counts(x: Axis, values: Sequence[float]) -> list[int]:
    """Number of values in each bin."""
    found = [0] * BINS
    for value in values:
        share = (x.at(value) - x.start) / (x.end - x.start)
        found[min(BINS - 1, max(0, int(share * BINS)))] += 1
    return found


def bars(
    x: Axis, y: Axis, good: Sequence[int], bad: Sequence[int], kinds: Sequence[str] = GOOD_BAD
) -> list[str]:
    """Bars of the passed runs, with the others stacked on top."""
    parts, width = [], (x.end - x.start) / BINS
    for k, (g, b) in enumerate(zip(good, bad, strict=True)):
        left = x.start + k * width + 0.75
        ends = number(x.value(k / BINS)), number(x.value((k + 1) / BINS))
        hint = f"{ends[0]} to {ends[1]}: {g} passed, {b} not"
        for kind, bottom, top in zip(kinds, (0, g), (g, g + b), strict=True):
            if top > bottom:
                parts.append(
                    f'<rect class="{kind}" x="{left:.1f}" y="{y.at(top):.1f}" '
                    f'width="{width - 1.5:.1f}" height="{y.at(bottom) - y.at(top):.1f}">'
                    f"<title>{escape(hint)}</title></rect>"
                )
    return parts


class Strip(NamedTuple):
    """One case's row in a picture of distributions."""

    name: str
    passed: Sequence[float]
    others: Sequence[float]
    median: float | None  # None if no run has the number
    words: str


def strips(rows: Sequence[Strip], title: str) -> str:
    """Histograms below each other, with a common axis and scale."""
    x = along([value for row in rows for value in (*row.passed, *row.others)], title)
    found = [(counts(x, row.passed), counts(x, row.others)) for row in rows]
    highest = max(g + b for good, bad in found for g, b in zip(good, bad, strict=True))
    bottom = STRIP * len(rows) + 6.0
    parts = frame(x, Axis(0.0, 1.0, bottom, 4.0, "runs"), y_ticks=False)
    for k, (row, (good, bad)) in enumerate(zip(rows, found, strict=True)):
        y = Axis(0.0, highest, STRIP * (k + 1) + 2.0, STRIP * k + 23.0, "")
        parts.append(f'<path class="axis" d="M{x.start:g} {y.start:g}H{x.end:g}"/>')
        for value in (0, highest):
            parts.append(text(x.start - 7, y.at(value) + 3.5, str(value), "tick", END))
        parts += bars(x, y, good, bad, (f"case solid c{k}", f"case open c{k}"))
        if row.median is not None:
            at = x.at(row.median)
            parts.append(f'<path class="median" d="M{at:.1f} {y.start + 3:g}V{y.end:g}"/>')
        parts.append(case_mark(k, x.start + 5, y.end - 10, 4.0))
        room = x.end - x.start - 26 - LETTER * len(row.words)
        parts.append(text(x.start + 14, y.end - 6, cut(row.name, int(room / LETTER)), "row"))
        parts.append(text(x.end, y.end - 6, row.words, "tick", END))
    return page(parts, f"distribution of {title} by case", bottom + BOTTOM)


def cut(words: str, most: int) -> str:
    """The text, truncated to `most` characters."""
    return words if len(words) <= most else words[: max(1, most - 1)] + "\N{HORIZONTAL ELLIPSIS}"


def case_mark(
    case: int, x: float, y: float, radius: float, kind: str = "solid", hint: str = ""
) -> str:
    """A case's mark in its colour."""
    corners = MARKS[case]
    if corners:
        path = "M" + "L".join(f"{x + radius * a:.1f} {y + radius * b:.1f}" for a, b in corners)
    else:
        arc = f"a{radius:g} {radius:g} 0 1 0 "
        path = f"M{x - radius:.1f} {y:.1f}{arc}{2 * radius:g} 0{arc}{-2 * radius:g} 0"
    title = f"<title>{escape(hint)}</title>" if hint else ""
    return f'<path class="case c{case} {kind}" d="{path}z">{title}</path>'


def legend(names: Sequence[str], top: float, hollow: bool) -> tuple[list[str], float]:
    """The legend of the cases, in as many lines as needed, and its lower end."""
    parts, at, y = [], LEFT, top
    for k, name in enumerate([*names, HOLLOW] if hollow else names):
        words = cut(name, int((WIDTH - LEFT - RIGHT - 14) / LETTER))
        length = 14 + LETTER * len(words)
        if at + length > WIDTH - RIGHT and at > LEFT:
            at, y = LEFT, y + LINE
        if k < len(names):
            parts.append(case_mark(k, at + 5, y - 4, 4.0))
        else:
            parts.append(f'<circle class="case open" cx="{at + 5:.1f}" cy="{y - 4:g}" r="3.6"/>')
        parts.append(text(at + 14, y, words, "row"))
        at += length + 16
    return parts, y + 10


def mark(x: float, y: float, point: Point, kind: str = "") -> str:
    """The mark of one run."""
    hint = f"<title>{escape(point.hint)}</title>"
    if point.passed:
        return f'<circle class="good {kind}" cx="{x:.1f}" cy="{y:.1f}" r="3">{hint}</circle>'
    cross = f"M{x - 3.2:.1f} {y - 3.2:.1f}l6.4 6.4m0 -6.4l-6.4 6.4"
    return f'<path class="bad-mark {kind}" d="{cross}">{hint}</path>'


def scatter(
    points: Sequence[Point],
    x_title: str,
    y_title: str,
    fronts: Sequence[Sequence[Point]] = (),
    names: Sequence[str] = (),
) -> str:
    """Scatter plot of runs, by case if `names` are given, with fronts as lines."""
    x_log, y_log = wants_log([p.x for p in points]), wants_log([p.y for p in points])
    x = wide(*(log_span if x_log else span)([p.x for p in points]), x_title, x_log)
    y = tall(*(log_span if y_log else span)([p.y for p in points]), y_title, y_log)
    parts, height = frame(x, y), HEIGHT
    if names:
        for p in points:
            kind = "" if p.passed else "open"
            parts.append(case_mark(p.case, x.at(p.x), y.at(p.y), 3.0, kind, p.hint))
        more, height = legend(names, HEIGHT + 10.0, any(not p.passed for p in points))
        parts += more
    else:
        parts += [mark(x.at(p.x), y.at(p.y), p) for p in points]
    for front in fronts:
        path = f"M{x.at(front[0].x):.1f} {y.at(front[0].y):.1f}"
        path += "".join(f"H{x.at(p.x):.1f}V{y.at(p.y):.1f}" for p in front[1:])
        colour = f" c{front[0].case}" if names else ""
        parts.append(f'<path class="front{colour}" d="{path}"/>')
        for p in front:
            at = x.at(p.x), y.at(p.y)
            if names:
                parts.append(case_mark(p.case, *at, 4.5, "front-mark", p.hint))
            else:
                parts.append(
                    f'<circle class="front-mark" cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="4.5">'
                    f"<title>{escape(p.hint)}</title></circle>"
                )
    return page(parts, f"{y_title} against {x_title}", height)


class Cell(NamedTuple):
    """One field of a heat map."""

    column: int
    row: int
    share: float  # darkness, 0 to 1
    words: str
    hint: str


def heat(
    cells: Sequence[Cell], columns: Sequence[str], rows: Sequence[str], x_title: str, y_title: str
) -> str:
    """A heat map."""
    left = max(LEFT, 28.0 + 6.4 * max(len(name) for name in rows))
    x, y = wide(0, len(columns), x_title)._replace(start=left), tall(0, len(rows), y_title)
    parts = frame(x, y, x_ticks=False, y_ticks=False)
    side, rise = x.at(1) - x.at(0), y.at(0) - y.at(1)
    for cell in cells:
        left, top = x.at(cell.column), y.at(cell.row + 1)
        parts.append(
            f'<rect class="heat" x="{left + 1:.1f}" y="{top + 1:.1f}" width="{side - 2:.1f}" '
            f'height="{rise - 2:.1f}" rx="2" style="--share:{cell.share:.3f}">'
            f"<title>{escape(cell.hint)}</title></rect>"
        )
        kind = "on-heat dark" if cell.share > 0.75 else "on-heat"
        if side > 26:
            at = left + side / 2, top + rise / 2 + 3.5
            parts.append(text(*at, cell.words, kind, 'text-anchor="middle"'))
    for k, name in enumerate(columns):
        parts.append(text(x.at(k + 0.5), y.start + 15, name, "tick", 'text-anchor="middle"'))
    for k, name in enumerate(rows):
        parts.append(text(x.start - 7, y.at(k + 0.5) + 3.5, name, "tick", 'text-anchor="end"'))
    return page(parts, f"{y_title} by {x_title}")


class Whisker(NamedTuple):
    """A rate with its interval."""

    name: str
    low: float
    rate: float
    high: float
    words: str
    case: int | None = None  # index of its colour and mark


def whiskers(rows: Sequence[Whisker]) -> str:
    """Success rates with intervals, from 0 to 100 %."""
    longest = max(len(row.name) for row in rows)
    left = min(200.0, 16.0 + 6.2 * longest)
    height = 30.0 + 22.0 * len(rows) + 12.0
    right = 26.0 + 6.2 * max(len(row.words) for row in rows)
    x = Axis(0.0, 100.0, left, WIDTH - right, "")
    parts = []
    for value in (0, 25, 50, 75, 100):
        at = x.at(value)
        parts.append(f'<path class="grid" d="M{at:.1f} 8V{height - 26:.1f}"/>')
        parts.append(text(at, height - 12, f"{value} %", "tick", 'text-anchor="middle"'))
    others = "whisker", "good"
    if any(row.case is not None for row in rows):
        others = "whisker rest", "case solid rest"
    for k, row in enumerate(rows):
        y = 22.0 + 22.0 * k
        kind = others[0] if row.case is None else f"whisker c{row.case}"
        ends, at = (x.at(100 * row.low), x.at(100 * row.high)), x.at(100 * row.rate)
        parts.append(text(left - 10, y + 3.5, cut(row.name, 31), "row", END))
        parts.append(f'<path class="{kind}" d="M{ends[0]:.1f} {y:.1f}H{ends[1]:.1f}"/>')
        parts.append(
            f'<circle class="{others[1]}" cx="{at:.1f}" cy="{y:.1f}" r="4.5"/>'
            if row.case is None else case_mark(row.case, at, y, 4.5)
        )  # fmt: skip
        parts.append(text(x.end + 10, y + 3.5, row.words, "row"))
    return page(parts, "success rate with interval", height)
