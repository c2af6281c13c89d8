"""Charts as SVG text, drawn with the colours of the page they stand on.

One size of type, thin axes, a grid one can look through. A point that passed is a disc, one that
did not is a cross, so colour is never all there is.
"""

import math
from collections.abc import Sequence
from html import escape
from typing import NamedTuple

WIDTH, HEIGHT = 420.0, 260.0
LOG_FROM = 6.0  # largest over least number
LEFT, RIGHT, TOP, BOTTOM = 66.0, 12.0, 14.0, 42.0


class Point(NamedTuple):
    """One run in a scatter."""

    x: float
    y: float
    passed: bool
    hint: str


class Axis(NamedTuple):
    """From numbers to the page."""

    low: float
    high: float
    start: float  # on the page
    end: float
    title: str
    log: bool = False
    whole: bool = False  # it counts things: nothing between two numbers

    @property
    def words(self) -> str:
        """What stands beside it."""
        return f"{self.title}, log scale" if self.log else self.title

    def at(self, value: float) -> float:
        """Where a number is on the page."""
        share = (value - self.low) / (self.high - self.low)
        if self.log:
            share = math.log(value / self.low) / math.log(self.high / self.low)
        return self.start + (self.end - self.start) * share

    def ticks(self) -> list[float]:
        """Round numbers along it."""
        if self.log:
            return log_ticks(self.low, self.high)
        return [t for t in ticks(self.low, self.high) if not self.whole or t == round(t)]


def wants_log(values: Sequence[float]) -> bool:
    """Whether the numbers span so much that the small ones would be lost."""
    return min(values) > 0.0 and max(values) > LOG_FROM * min(values)


def log_span(values: Sequence[float], room: float = 0.04) -> tuple[float, float]:
    """Like `span`, for a logarithmic axis."""
    more = (max(values) / min(values)) ** room
    return min(values) / more, max(values) * more


def log_ticks(low: float, high: float) -> list[float]:
    """1, 2, 5 of each power of ten, or the powers alone where those are many."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = (1.0, 2.0, 5.0) if math.log10(high / low) < 3.0 else (1.0,)
    return [m * 10.0**n for n in powers for m in steps if low <= m * 10.0**n <= high]


def span(values: Sequence[float], room: float = 0.04) -> tuple[float, float]:
    """From the least to the largest with some room, never of no width."""
    low, high = min(values), max(values)
    if not high - low > 1e-12 * max(1.0, abs(high)):
        return low - 0.5 * (abs(low) or 1.0), high + 0.5 * (abs(high) or 1.0)
    return low - room * (high - low), high + room * (high - low)


def ticks(low: float, high: float, count: int = 5) -> list[float]:
    """Round numbers between two ends."""
    raw = (high - low) / count
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(power * m for m in (1.0, 2.0, 2.5, 5.0, 10.0) if power * m >= raw)
    first = math.ceil(low / step - 1e-9)
    return [k * step for k in range(first, math.floor(high / step + 1e-9) + 1)]


def number(value: float) -> str:
    """A number as a label has it."""
    return f"{0.0 if abs(value) < 1e-12 else value:.4g}".replace("-", "\N{MINUS SIGN}")


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
    """Words on the page."""
    return f'<text class="{kind}" x="{x:.1f}" y="{y:.1f}" {extra}>{escape(words)}</text>'


def frame(x: Axis, y: Axis, x_ticks: bool = True, y_ticks: bool = True) -> list[str]:
    """Grid, numbers and titles."""
    parts = []
    for value in y.ticks() if y_ticks else ():
        at = y.at(value)
        parts.append(f'<path class="grid" d="M{x.start:g} {at:.1f}H{x.end:g}"/>')
        parts.append(text(x.start - 7, at + 3.5, number(value), "tick", 'text-anchor="end"'))
    for value in x.ticks() if x_ticks else ():
        at = x.at(value)
        parts.append(f'<path class="grid" d="M{at:.1f} {y.start:g}V{y.end:g}"/>')
        parts.append(text(at, y.start + 15, number(value), "tick", 'text-anchor="middle"'))
    parts.append(f'<path class="axis" d="M{x.start:g} {y.start:g}H{x.end:g}"/>')
    middle = 0.5 * (x.start + x.end)
    parts.append(text(middle, y.start + 33, x.words, "label", 'text-anchor="middle"'))
    if y.title:
        up = 0.5 * (y.start + y.end)
        turned = f'text-anchor="middle" transform="rotate(-90 13 {up:g})"'
        parts.append(text(13, up, y.words, "label", turned))
    return parts


def histogram(passed: Sequence[float], others: Sequence[float], title: str, bins: int = 24) -> str:
    """How often a number lies where; those that did not pass on top."""
    values = [*passed, *others]
    log = wants_log(values)
    low, high = log_span(values, 0.0) if log else span(values, 0.0)
    x = wide(low, high, title, log)
    width = (x.end - x.start) / bins

    def count(of: Sequence[float]) -> list[int]:
        found = [0] * bins
        for value in of:
            found[min(bins - 1, max(0, int((x.at(value) - x.start) / width)))] += 1
        return found

    def edge(k: int) -> float:
        share = k / bins
        return low * (high / low) ** share if log else low + share * (high - low)

    good, bad = count(passed), count(others)
    highest = max(g + b for g, b in zip(good, bad, strict=True))
    y = tall(0.0, 1.08 * highest, "runs")._replace(whole=True)
    parts = frame(x, y)
    for k, (g, b) in enumerate(zip(good, bad, strict=True)):
        left = x.start + k * width + 0.75
        hint = f"{number(edge(k))} to {number(edge(k + 1))}: {g} passed, {b} not"
        for kind, bottom, top in (("good", 0, g), ("bad", g, g + b)):
            if top > bottom:
                parts.append(
                    f'<rect class="{kind}" x="{left:.1f}" y="{y.at(top):.1f}" '
                    f'width="{width - 1.5:.1f}" height="{y.at(bottom) - y.at(top):.1f}">'
                    f"<title>{escape(hint)}</title></rect>"
                )
    return page(parts, f"distribution of {title}")


def mark(x: float, y: float, point: Point, kind: str = "") -> str:
    """One run."""
    hint = f"<title>{escape(point.hint)}</title>"
    if point.passed:
        return f'<circle class="good {kind}" cx="{x:.1f}" cy="{y:.1f}" r="3">{hint}</circle>'
    cross = f"M{x - 3.2:.1f} {y - 3.2:.1f}l6.4 6.4m0 -6.4l-6.4 6.4"
    return f'<path class="bad-mark {kind}" d="{cross}">{hint}</path>'


def scatter(
    points: Sequence[Point], x_title: str, y_title: str, front: Sequence[Point] = ()
) -> str:
    """Runs by two numbers; a front is drawn as a line from point to point."""
    x_log, y_log = wants_log([p.x for p in points]), wants_log([p.y for p in points])
    x = wide(*(log_span if x_log else span)([p.x for p in points]), x_title, x_log)
    y = tall(*(log_span if y_log else span)([p.y for p in points]), y_title, y_log)
    parts = frame(x, y)
    parts += [mark(x.at(p.x), y.at(p.y), p) for p in points]
    if front:
        path = f"M{x.at(front[0].x):.1f} {y.at(front[0].y):.1f}"
        path += "".join(f"H{x.at(p.x):.1f}V{y.at(p.y):.1f}" for p in front[1:])
        parts.append(f'<path class="front" d="{path}"/>')
        for p in front:
            parts.append(
                f'<circle class="front-mark" cx="{x.at(p.x):.1f}" cy="{y.at(p.y):.1f}" r="4.5">'
                f"<title>{escape(p.hint)}</title></circle>"
            )
    return page(parts, f"{y_title} against {x_title}")


class Cell(NamedTuple):
    """One field of a heat map."""

    column: int
    row: int
    share: float  # 0 to 1: how dark
    words: str
    hint: str


def heat(
    cells: Sequence[Cell], columns: Sequence[str], rows: Sequence[str], x_title: str, y_title: str
) -> str:
    """Numbers on a grid of two axes."""
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


def whiskers(rows: Sequence[Whisker]) -> str:
    """Rates one below the other, from 0 to 100 %."""
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
    for k, row in enumerate(rows):
        y = 22.0 + 22.0 * k
        name = row.name if len(row.name) < 32 else row.name[:30] + "\N{HORIZONTAL ELLIPSIS}"
        parts.append(text(left - 10, y + 3.5, name, "row", 'text-anchor="end"'))
        parts.append(
            f'<path class="whisker" d="M{x.at(100 * row.low):.1f} {y:.1f}'
            f'H{x.at(100 * row.high):.1f}"/>'
            f'<circle class="good" cx="{x.at(100 * row.rate):.1f}" cy="{y:.1f}" r="4.5"/>'
        )
        parts.append(text(x.end + 10, y + 3.5, row.words, "row"))
    return page(parts, "success rate with interval", height)
