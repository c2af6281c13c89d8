"""Draws charts as SVG, for every page and every file with figures.

Every colour is a class of theme.css, so a figure follows the light or dark theme of its page; a
stand-alone file includes the light one. Long series are reduced to the largest and smallest value
per pixel column, which looks the same.
"""

import math
import re
from html import escape
from itertools import pairwise
from pathlib import Path

import numpy as np

from testbed.report.axis import Axis, number
from testbed.report.item import (
    HUES,
    Array,
    Box,
    Chart,
    Disc,
    Item,
    Key,
    Limit,
    Line,
    Mark,
    Moment,
    Point,
    Raster,
    Words,
)

THEME = Path(__file__).with_name("theme.css").read_text(encoding="utf-8")
APART = 14.0  # least distance of two limits' names, baseline to baseline
THINNEST = 0.7  # width of a bar, so that a pulse of milliseconds is visible in a run of minutes
TIME = "time [s]"  # label of a time axis
MARKS = 4  # on a line
BEYOND = (-0.02, 1.02)  # shares of the height; what is further out is drawn there
LEFT, RIGHT, TOP, BOTTOM = 62, 16, 14, 44
LETTER, WIDE_LETTER, ROW = 7.2, 9.0, 18  # of a legend: widths of a letter, height of a row

# Corners of the cases' marks about their centre, in radii of the disc, which is the first.
SHAPES: tuple[tuple[tuple[float, float], ...], ...] = (
    (),
    ((-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.9, 0.9)),
    ((0.0, -1.25), (1.2, 0.9), (-1.2, 0.9)),
    ((0.0, -1.4), (1.1, 0.0), (0.0, 1.4), (-1.1, 0.0)),
    ((0.0, 1.25), (1.2, -0.9), (-1.2, -0.9)),
    ((-0.4, -1.3), (0.4, -1.3), (0.4, -0.4), (1.3, -0.4), (1.3, 0.4), (0.4, 0.4),
     (0.4, 1.3), (-0.4, 1.3), (-0.4, 0.4), (-1.3, 0.4), (-1.3, -0.4), (-0.4, -0.4)),
    ((-1.25, 0.0), (0.9, -1.2), (0.9, 1.2)),
    ((0.0, -1.5), (0.4, -0.4), (1.5, 0.0), (0.4, 0.4), (0.0, 1.5), (-0.4, 0.4), (-1.5, 0.0),
     (-0.4, -0.4)),
)  # fmt: skip


def draw(chart: Chart) -> str:
    """The figure as an SVG element of an HTML page."""
    frame = _Frame(chart)
    shapes = [frame.item(item) for item in chart.items]
    names = f'<g class="names">{"".join(frame.names)}</g>' * bool(frame.names)  # no line hides them
    body = [*frame.axes(), *shapes, names, *frame.legend()]
    return (
        f'<svg viewBox="0 0 {chart.width} {frame.height:.0f}" role="img" '
        f'aria-label="{escape(chart.title)}" {frame.attributes()}>' + "".join(body) + "</svg>"
    )


def alone(chart: Chart, drawing: str | None = None) -> str:
    """The figure as a stand-alone file, on white; `drawing` is what `draw` has given for it."""
    head, _, rest = (drawing or draw(chart)).partition(">")
    height = head.split()[4].rstrip('"')
    colours, _, style = THEME.partition("}")
    style = style[style.index("svg text") :]
    for name, colour in re.findall(r"--(\w+): (#\w+)", colours):
        style = style.replace(f"var(--{name})", colour)  # drawing programs do not support var()
    style = re.sub(r"\.heat \{[^}]*\}", "", style)
    return (
        f'{head} xmlns="http://www.w3.org/2000/svg" width="{chart.width}" height="{height}">'
        f'<style>{style}</style><rect width="100%" height="100%" fill="#ffffff"/>{rest}\n'
    )


def mark(item: Mark, x: float, y: float) -> str:
    """A mark at a position in pixels."""
    hint = f"<title>{escape(item.hint)}</title>" if item.hint else ""
    r, looks = item.radius, f"mark {item.style}"
    if item.case is None and not item.passed:
        cross = f"M{x - r:.1f} {y - r:.1f}l{2 * r:g} {2 * r:g}m0 {-2 * r:g}l{-2 * r:g} {2 * r:g}"
        return f'<path class="{looks} cross" d="{cross}">{hint}</path>'
    if item.case is None:
        return f'<circle class="{looks} good" cx="{x:.1f}" cy="{y:.1f}" r="{r:g}">{hint}</circle>'
    looks += f" s{item.case} f{item.case}" + " open" * (not item.passed)
    if not (corners := SHAPES[item.case]):
        return f'<circle class="{looks}" cx="{x:.1f}" cy="{y:.1f}" r="{r:g}">{hint}</circle>'
    path = "M" + "L".join(f"{x + r * a:.1f} {y + r * b:.1f}" for a, b in corners)
    return f'<path class="{looks}" d="{path}z">{hint}</path>'


def text(x: float, y: float, words: str, look: str = "", anchor: str = "start") -> str:
    """A text element at a position in pixels."""
    look = f'class="{look}" ' if look else ""
    return f'<text {look}x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(words)}</text>'


def thinned(x: Array, y: Array, columns: int) -> tuple[Array, Array]:
    """The largest and smallest y per column, in order of x."""
    if len(x) <= 4 * columns:
        return x, y
    edges = np.linspace(0, len(x), columns + 1).astype(int)
    keep = {0, len(x) - 1}
    for a, b in pairwise(edges.tolist()):
        part = y[a:b]
        if np.isnan(part).all():
            keep.add(int(a))
        else:
            keep.update((int(a + np.nanargmin(part)), int(a + np.nanargmax(part))))
    index = np.array(sorted(keep))
    return x[index], y[index]


class _Frame:
    """Converts data to positions in the figure and draws its parts."""

    def __init__(self, chart: Chart) -> None:
        self.chart = chart
        x0, x1 = chart.x_range
        y0, y1 = chart.y_range or _range(chart)
        self.left = max(
            LEFT, 22 + 7 * max((len(name) for _, name in chart.y_ticks or ()), default=0)
        )
        beside = max((len(words) for _, words in chart.side), default=0)
        self.right = chart.width - RIGHT - round(LETTER * beside)
        width = self.right - self.left
        rows = 1 + max([row for _, _, row in self._placed()], default=-1)
        self.top = TOP + (ROW * rows + 4 if rows else 0)
        inner = width * (y1 - y0) / (x1 - x0) if chart.equal else float(chart.height)
        self.bottom = self.top + inner
        self.height = self.bottom + BOTTOM
        self.x = Axis(x0, x1, self.left, self.right, chart.x_log)
        self.y_axis = Axis(y0, y1, self.bottom, self.top, chart.log, chart.whole)
        self.per = width / (x1 - x0)  # pixels per unit of x
        self._name_at = self._names_of_limits()
        self.names: list[str] = []  # of the drawn items

    def attributes(self) -> str:
        """The frame for report.js: position and range of both axes."""
        x, y = self.x, self.y_axis
        ends = (self.left, self.top, self.right, self.bottom, x.low, x.high, y.low, y.high)
        time = 'data-time="1" ' * (self.chart.x_label == TIME and not self.chart.x_log)
        unit = re.search(r"\[(.+?)\]", self.chart.y_label)
        of = f'data-unit="{escape(unit[1])}" ' if unit and time else ""
        numbers = " ".join(f"{one:.6g}" for one in ends)
        return f'{time}{of}data-frame="{numbers} {int(self.chart.log)}"'

    def _names_of_limits(self) -> dict[str, float]:
        """Height of each limit's name: above its line, or below it if there is no room."""
        limits = [(self.y(i.y), i.name) for i in self.chart.items if isinstance(i, Limit)]
        found: dict[str, float] = {}
        last = -math.inf
        for at, name in sorted(limits):
            above, below = at - 5.0, at + 13.0
            last = above if above >= last + APART else max(below, last + APART)
            found[name] = last
        return found

    def y(self, value: float) -> float:
        low, high = BEYOND
        share = min(max(self.y_axis.share(value), low), high)
        return self.bottom - (self.bottom - self.top) * share

    def axes(self) -> list[str]:
        chart, out = self.chart, []
        x0, x1, y0, y1 = self.left, self.right, self.top, self.bottom
        if chart.equal:
            out.append(f'<rect class="table" x="{x0}" y="{y0}" width="{x1 - x0}" '
                       f'height="{y1 - y0:.1f}"/>')  # fmt: skip
        if chart.x_ticks is None:
            for value in self.x.ticks(round((x1 - x0) / 65)):
                at = self.x.at(value)
                out.append(f'<path class="grid" d="M{at:.1f} {y0}V{y1:.1f}"/>'
                           + text(at, y1 + 17, number(value, 10), "", "middle"))  # fmt: skip
        out += [
            text(self.x.at(x), y1 + 17, words, "", "middle") for x, words in chart.x_ticks or ()
        ]
        if chart.y_ticks is None:
            for value in self.y_axis.ticks(round((y1 - y0) / 38)):
                at = self.y(value)
                out.append(f'<path class="grid" d="M{x0} {at:.1f}H{x1}"/>'
                           + text(x0 - 7, at + 4, number(value, 10), "", "end"))  # fmt: skip
        crowded = "small" if (y1 - y0) < 13 * len(chart.y_ticks or ()) else ""
        for y, words in chart.y_ticks or ():
            out.append(text(x0 - 7, self.y(y) + (3 if crowded else 4), words, crowded, "end"))
        out += [text(x1 + 10, self.y(y) + 4, words, "name") for y, words in chart.side]
        out.append(f'<path class="axis" d="M{x0} {y1:.1f}H{x1}M{x0} {y0}V{y1:.1f}"/>'
                   + text((x0 + x1) / 2, y1 + 36, chart.x_label, "name", "middle"))  # fmt: skip
        if chart.y_label:
            middle = f"translate(13 {(y0 + y1) / 2:.1f}) rotate(-90)"
            out.append(f'<text class="name" transform="{middle}" text-anchor="middle">'
                       f"{escape(chart.y_label)}</text>")  # fmt: skip
        return out

    def item(self, item: Item) -> str:
        match item:
            case Line(x, y, hue, name, style):
                data = f' data-name="{escape(item.hint or name)}" data-hue="{hue % HUES}"'
                return (f'<path class="line s{hue % HUES} {style}"{data * bool(item.hint or name)} '
                        f'd="{self._path(x, y)}"/>{self._marks(item)}')  # fmt: skip
            case Limit(y, name, style):
                look = f"limit {style}".rstrip()
                of = f"limitname {style}".rstrip()
                self.names.append(text(self.right - 4, self._name_at[name], name, of, "end"))
                return f'<path class="{look}" d="M{self.left} {self.y(y):.1f}H{self.right}"/>'
            case Moment(x, name, style):
                at = self.x.at(x)
                if not name:
                    return (
                        f'<path class="limit {style}" d="M{at:.1f} {self.top}V{self.bottom:.1f}"/>'
                    )
                moments = [i.x for i in self.chart.items if isinstance(i, Moment) and i.name]
                row = self.top + 12.0 + APART * sum(other < x for other in moments)
                late = at + LETTER * len(name) > self.right  # no room on the right
                side = (at - 5, "end") if late else (at + 5, "start")
                of = " value" * (style == "value")
                self.names.append(text(side[0], row, name, f"limitname{of}", side[1]))
                return f'<path class="limit{of}" d="M{at:.1f} {self.top}V{self.bottom:.1f}"/>'
            case Disc(x, y, radius, style, hue):
                paint = f"{style} s{hue % HUES} f{hue % HUES}" if style == "ghost" else style
                return (f'<circle class="{paint}" cx="{self.x.at(x):.1f}" cy="{self.y(y):.1f}" '
                        f'r="{radius * self.per:.1f}"/>')  # fmt: skip
            case Point():
                return self._point(item)
            case Raster():
                return self._raster(item)
            case Mark(x, y):
                return mark(item, self.x.at(x) + item.shift, self.y(y))
            case Box():
                return self._box(item)
            case Words(x, y, words, anchor, style, shift):
                return text(self.x.at(x) + shift, self.y(y), words, style, anchor)
            case Key():
                return ""  # in the legend

    def _path(self, x: Array, y: Array) -> str:
        if not self.chart.equal:
            x, y = thinned(x, y, self.chart.width)
        elif len(x) > 1500:
            x, y = x[:: len(x) // 1500 + 1], y[:: len(y) // 1500 + 1]
        across = self.x.start + (self.x.end - self.x.start) * self.x.shares(x)
        up = self.bottom - (self.bottom - self.top) * self.y_axis.shares(y).clip(*BEYOND)
        gaps = np.isnan(across) | np.isnan(up)
        ends = np.flatnonzero(np.diff(gaps, prepend=True, append=True))  # of each piece
        points = list(map("{:.1f} {:.1f}".format, across.tolist(), up.tolist()))
        return "".join("M" + "L".join(points[a:b]) for a, b in ends.reshape(-1, 2).tolist())

    def _marks(self, line: Line) -> str:
        """The vehicle's shape a few times along its line, where several lines are told apart."""
        named = {i.hue for i in self.chart.items if isinstance(i, Line) and i.name}
        seen = np.flatnonzero(np.isfinite(line.x) & np.isfinite(line.y))
        if not line.name or line.style not in ("", "dashed") or len(named) < 2 or len(seen) < 2:
            return ""
        shares = (np.arange(MARKS) + (0.5 + line.hue % HUES) / HUES) / MARKS
        if self.chart.equal:
            picked = seen[(shares * (len(seen) - 1)).astype(int)]
        else:
            low, high = self.chart.x_range
            picked = seen[
                np.searchsorted(line.x[seen], low + shares * (high - low)).clip(0, len(seen) - 1)
            ]
        return "".join(
            mark(Mark(0.0, 0.0, case=line.hue % HUES, style="full", radius=3),
                 self.x.at(float(line.x[k])), self.y(float(line.y[k])))
            for k in dict.fromkeys(picked.tolist())
        )  # fmt: skip

    def _raster(self, raster: Raster) -> str:
        start, length = raster.start, raster.length
        at = self.y(raster.row + 0.5)
        thick = 0.72 * abs(self.y(1.0) - self.y(0.0))
        inside = (start + length > self.x.low) & (start < self.x.high)
        widths = np.maximum(length[inside] * self.per, THINNEST).tolist()
        bars = "".join(
            f"M{self.x.at(max(s, self.x.low)):.1f} {at:.1f}h{w:.2f}"
            for s, w in zip(start[inside].tolist(), widths, strict=True)
        )
        return f'<path class="s{raster.hue % HUES}" style="stroke-width:{thick:.1f}" d="{bars}"/>'

    def _box(self, box: Box) -> str:
        left, right = (self.x.at(x) for x in box.x)
        bottom, top = (self.y(y) for y in box.y)
        hue = "" if box.hue is None else f" s{box.hue} f{box.hue}"
        share = f' style="--share:{box.share:.3f}"' if box.style == "heat" else ""
        words = ""
        if box.words and right - left > LETTER * len(box.words):
            look = "on-heat dark" if box.share > 0.75 else "on-heat"
            words = text((left + right) / 2, (top + bottom) / 2 + 4, box.words, look, "middle")
        return (f'<rect class="box {box.style}{hue}"{share} x="{left + 0.75:.1f}" y="{top:.1f}" '
                f'width="{right - left - 1.5:.1f}" height="{bottom - top:.1f}">'
                f"<title>{escape(box.hint)}</title></rect>{words}")  # fmt: skip

    def _point(self, point: Point) -> str:
        a, b, hue = self.x.at(point.x), self.y(point.y), point.hue % HUES
        away = max(9.0, 3.0 + 0.72 * point.room * self.per)
        late = a + away + LETTER * len(point.name) > self.right  # no room on the right
        side = (a - away, "end") if late else (a + away, "start")
        if point.name:
            height = max(b - away, self.top + 11)
            look = "limitname" if point.shape in ("hit", "fault") else f"name f{hue}"
            self.names.append(text(side[0], height, point.name, look, side[1]))
        if point.shape == "hit":
            return (f'<path class="line hit" d="M{a - 7:.1f} {b:.1f}h14m-7 -7v14m-5 -12l10 10m0 -10'
                    'l-10 10"/>')  # fmt: skip
        if point.shape == "fault":
            return f'<path class="line hit" d="M{a - 8:.1f} {b - 8:.1f}l16 16m0 -16l-16 16"/>'
        if point.shape == "ring":
            return f'<circle class="line s{hue}" cx="{a:.1f}" cy="{b:.1f}" r="5"/>'
        return f'<path class="line s{hue}" d="M{a - 5:.1f} {b - 5:.1f}l10 10m0 -10l-10 10"/>'

    def legend(self) -> list[str]:
        out = []
        for item, at, row in self._placed():
            y = TOP + ROW * row + 4
            if isinstance(item, Line):
                look = f"line s{item.hue % HUES} {item.style}"
                out.append(f'<path class="{look}" d="M{at:.0f} {y}h22"/>')
                if self._marks(item):
                    sample = Mark(0.0, 0.0, case=item.hue % HUES, style="full", radius=3)
                    out.append(mark(sample, at + 11, y))
            elif item.case is None:
                out.append(f'<circle class="hollow" cx="{at + 5:.1f}" cy="{y}" r="3.6"/>')
            else:
                out.append(mark(Mark(0.0, 0.0, case=item.case, style="full", radius=4), at + 5, y))
            out.append(text(at + _sample(item), y + 4, item.name, "name"))
        return out

    def _placed(self) -> list[tuple[Line | Key, float, int]]:
        """Entries of the legend, each with its position along x and its row."""
        out: list[tuple[Line | Key, float, int]] = []
        at, row = float(self.left), 0
        for item in self.chart.items:
            if not isinstance(item, Line | Key) or not item.name:
                continue
            letters = len(item.name)  # 15 pixels high on a phone and on paper, 12 elsewhere
            wide = _sample(item) + max(LETTER * letters, WIDE_LETTER * letters - 10)
            if at + wide > self.right and at > self.left:
                at, row = float(self.left), row + 1
            out.append((item, at, row))
            at += wide + 18
        return out


def _sample(item: Line | Key) -> int:
    """Width of a legend's line or mark [px]."""
    return 28 if isinstance(item, Line) else 14


def _range(chart: Chart) -> tuple[float, float]:
    """Range of y with a margin, limits included."""
    values: list[float] = []
    for item in chart.items:
        match item:
            case Line(_, y):
                seen = y[np.isfinite(y)]
                if len(seen):
                    values += [float(seen.min()), float(seen.max())]
            case Limit(y) | Mark(y=y, style="paper"):
                values.append(y)
            case Raster(row):
                values += [row, row + 1]
    low, high = (min(values), max(values)) if values else (0.0, 1.0)
    if any(isinstance(item, Raster) for item in chart.items):
        return low, high
    if chart.log:
        high = max(high, 1e-9)
        low = max(low, 1e-5 * high)
        return 10.0 ** math.floor(math.log10(low)), 10.0 ** math.ceil(math.log10(high) + 0.01)
    size = max(abs(low), abs(high))
    constant = high - low < 1e-9 * size  # but for rounding
    air = 0.06 * (max(size, 1.0) if constant or high == low else high - low)
    return (low if low == 0.0 else low - air), high + air
