"""Draws figures as SVG without a plotting library.

A chart has axes with units and a list of items. Every colour is a class of the style sheet below,
so a figure follows the light or dark theme of its page; a stand-alone file includes the light one.
Long series are reduced to the largest and smallest value per pixel column, which looks the same.
"""

import math
from collections.abc import Sequence
from html import escape
from itertools import pairwise

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

Array = NDArray[np.float64]

WIDTH = 600  # of a figure; it scales with the page
HUES = 6
APART = 14.0  # least distance of two limits' names, baseline to baseline
THINNEST = 0.7  # width of a bar, so that a pulse of milliseconds is visible in a run of minutes
LEFT, RIGHT, TOP, BOTTOM = 62, 16, 14, 44
LETTER, ROW = 7.2, 18  # of a legend: width of a letter, height of a row

LIGHT = {
    "ink": "#1c2430", "soft": "#5b6675", "grid": "#e3e7ec", "stone": "#eef1f4",
    "danger": "#c62828", "h0": "#0069b4", "h1": "#d95f02", "h2": "#00876c", "h3": "#b0479a",
    "h4": "#7a6a00", "h5": "#4b4fa8",
}  # fmt: skip
STYLE = """
text { font: 12px system-ui, 'Helvetica Neue', Arial, sans-serif; fill: var(--soft); }
.name { fill: var(--ink); } .grid { stroke: var(--grid); stroke-width: 1; fill: none; }
.axis { stroke: var(--soft); stroke-width: 1; fill: none; }
.line { fill: none; stroke-width: 1.6; stroke-linejoin: round; stroke-linecap: round; }
.line.hit { stroke: var(--danger); stroke-width: 2.2; }
.line.way { stroke: var(--danger); opacity: .7; } .line.edge { stroke: var(--soft); opacity: .8; }
.thin { stroke-width: 1; opacity: .55; } .dashed { stroke-dasharray: 5 4; }
.dotted { stroke-dasharray: 1.5 4; }
.limit { stroke: var(--danger); stroke-width: 1.3; stroke-dasharray: 7 4; fill: none; }
.limitname { fill: var(--danger); } .table { fill: var(--stone); stroke: var(--soft); }
.danger { fill: var(--danger); fill-opacity: .09; stroke: var(--danger); stroke-dasharray: 5 4; }
.solid { fill: var(--soft); fill-opacity: .55; stroke: none; }
.ghost { fill-opacity: .10; stroke-opacity: .5; stroke-width: 1; }
""" + "".join(
    f".s{k} {{ stroke: var(--h{k}); }} .f{k} {{ fill: var(--h{k}); }}\n" for k in range(HUES)
)


class Line(Struct, frozen=True):
    """A series of points; NaN interrupts the line."""

    x: Array
    y: Array
    hue: int
    name: str = ""  # in the legend
    style: str = ""  # thin, dashed, dotted


class Limit(Struct, frozen=True):
    """A horizontal line at a limit of y."""

    y: float
    name: str


class Moment(Struct, frozen=True):
    """A vertical line at the time of an event."""

    x: float
    name: str


class Disc(Struct, frozen=True):
    """A circle in the figure's units."""

    x: float
    y: float
    radius: float
    style: str  # danger, solid, or ghost with a hue
    hue: int = 0


class Point(Struct, frozen=True):
    """A marker with a name."""

    x: float
    y: float
    hue: int
    shape: str  # ring: a start; cross: a goal; hit: a contact
    name: str = ""
    room: float = 0.0  # radius of the object, which the name stays outside of


class Raster(Struct, frozen=True):
    """One row of bars, such as a valve's pulses."""

    row: int
    start: Array
    length: Array
    hue: int
    name: str


Item = Line | Limit | Moment | Disc | Point | Raster


class Chart(Struct, frozen=True):
    """A figure: axes and items."""

    key: str  # name of its file
    title: str
    x_label: str
    y_label: str
    items: Sequence[Item]
    x_range: tuple[float, float]
    y_range: tuple[float, float] | None = None  # None: from the items
    log: bool = False  # y
    equal: bool = False  # equal scales of x and y; the range is a table
    height: int = 210
    width: int = WIDTH
    note: str = ""  # below the figure


def draw(chart: Chart) -> str:
    """The figure as an SVG element."""
    frame = _Frame(chart)
    body = [*frame.axes(), *(frame.item(item) for item in chart.items), *frame.legend()]
    return (
        f'<svg viewBox="0 0 {chart.width} {frame.height:.0f}" xmlns="http://www.w3.org/2000/svg" '
        f'role="img" aria-label="{escape(chart.title)}">' + "".join(body) + "</svg>"
    )


def alone(chart: Chart) -> str:
    """The figure as a stand-alone file, on white."""
    svg = draw(chart)
    head, _, rest = svg.partition(">")
    height = head.split()[4].rstrip('"')
    style = STYLE
    for name, colour in LIGHT.items():  # drawing programs do not support var()
        style = style.replace(f"var(--{name})", colour)
    return (
        f'{head} width="{chart.width}" height="{height}"><style>{style}</style>'
        f'<rect width="100%" height="100%" fill="#ffffff"/>{rest}\n'
    )


def ticks(low: float, high: float, about: int) -> list[float]:
    """Round numbers between `low` and `high`."""
    raw = max(high - low, 1e-300) / max(about, 1)
    unit = 10.0 ** math.floor(math.log10(raw))
    step = next(k * unit for k in (1.0, 2.0, 5.0, 10.0) if k * unit >= raw * 0.999)
    first = math.ceil(low / step - 1e-9)
    return [k * step for k in range(first, math.floor(high / step + 1e-9) + 1)]


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


def number(value: float) -> str:
    """Label of a tick."""
    return f"{0.0 if abs(value) < 1e-12 else value:.10g}".replace("-", "\N{MINUS SIGN}")


class _Frame:
    """Converts data to positions in the figure and draws its parts."""

    def __init__(self, chart: Chart) -> None:
        self.chart = chart
        self.x0, self.x1 = chart.x_range
        self.y0, self.y1 = chart.y_range or _range(chart)
        self.left = max(LEFT, 22 + 7 * max([len(r.name) for r in chart.items
                                             if isinstance(r, Raster)], default=0))  # fmt: skip
        self.right = chart.width - RIGHT
        self.width = self.right - self.left
        rows = 1 + max([row for _, _, row in self._placed()], default=-1)
        self.top = TOP + (ROW * rows + 4 if rows else 0)
        inner = float(chart.height)
        if chart.equal:
            inner = self.width * (self.y1 - self.y0) / (self.x1 - self.x0)
        self.bottom = self.top + inner
        self.height = self.bottom + BOTTOM
        self._name_at = self._names_of_limits()

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

    def x(self, value: float) -> float:
        return self.left + self.width * (value - self.x0) / (self.x1 - self.x0)

    def y(self, value: float) -> float:
        low, high = self.y0, self.y1
        if self.chart.log:
            value, low, high = math.log10(max(value, low)), math.log10(low), math.log10(high)
        share = (value - low) / (high - low)
        return self.bottom - (self.bottom - self.top) * min(max(share, -0.02), 1.02)

    def axes(self) -> list[str]:
        chart, out = self.chart, []
        if chart.equal:
            out.append(f'<rect class="table" x="{self.left}" y="{self.top}" width="{self.width}" '
                       f'height="{self.bottom - self.top:.1f}"/>')  # fmt: skip
        for value in ticks(self.x0, self.x1, 8):
            at = self.x(value)
            out.append(f'<path class="grid" d="M{at:.1f} {self.top}V{self.bottom:.1f}"/>'
                       f'<text x="{at:.1f}" y="{self.bottom + 17:.1f}" text-anchor="middle">'
                       f"{number(value)}</text>")  # fmt: skip
        rasters = [i for i in chart.items if isinstance(i, Raster)]
        for value in () if rasters else self._y_ticks():
            at = self.y(value)
            out.append(f'<path class="grid" d="M{self.left} {at:.1f}H{self.right}"/>'
                       f'<text x="{self.left - 7}" y="{at + 4:.1f}" text-anchor="end">'
                       f"{number(value)}</text>")  # fmt: skip
        for raster in rasters:
            at = self.y(raster.row + 0.5)
            out.append(f'<text x="{self.left - 7}" y="{at + 3:.1f}" text-anchor="end" '
                       f'style="font-size:10px">{escape(raster.name)}</text>')  # fmt: skip
        middle = (self.top + self.bottom) / 2
        out.append(f'<path class="axis" d="M{self.left} {self.bottom:.1f}H{self.right}'
                   f'M{self.left} {self.top}V{self.bottom:.1f}"/>'
                   f'<text class="name" x="{self.left + self.width / 2:.0f}" '
                   f'y="{self.bottom + 36:.1f}" text-anchor="middle">{escape(chart.x_label)}</text>'
                   f'<text class="name" transform="translate(13 {middle:.1f}) rotate(-90)" '
                   f'text-anchor="middle">{escape(chart.y_label)}</text>')  # fmt: skip
        return out

    def _y_ticks(self) -> list[float]:
        if not self.chart.log:
            return ticks(self.y0, self.y1, round((self.bottom - self.top) / 38))
        decades = range(math.ceil(math.log10(self.y0)), math.floor(math.log10(self.y1)) + 1)
        return [10.0**k for k in decades]

    def item(self, item: Item) -> str:
        match item:
            case Line(x, y, hue, _, style):
                return f'<path class="line s{hue % HUES} {style}" d="{self._path(x, y)}"/>'
            case Limit(y, name):
                at = self.y(y)
                return (f'<path class="limit" d="M{self.left} {at:.1f}H{self.right}"/>'
                        f'<text class="limitname" x="{self.right - 4}" '
                        f'y="{self._name_at[name]:.1f}" '
                        f'text-anchor="end">{escape(name)}</text>')  # fmt: skip
            case Moment(x, name):
                at = self.x(x)
                moments = [i.x for i in self.chart.items if isinstance(i, Moment)]
                row = self.top + 12.0 + APART * sum(other < x for other in moments)
                late = at + LETTER * len(name) > self.right  # no room on the right
                return (f'<path class="limit" d="M{at:.1f} {self.top}V{self.bottom:.1f}"/>'
                        f'<text class="limitname" x="{at - 5 if late else at + 5:.1f}" '
                        f'y="{row:.1f}" text-anchor="{"end" if late else "start"}">'
                        f"{escape(name)}</text>")  # fmt: skip
            case Disc(x, y, radius, style, hue):
                r = radius * self.width / (self.x1 - self.x0)
                paint = f"{style} s{hue % HUES} f{hue % HUES}" if style == "ghost" else style
                return (f'<circle class="{paint}" cx="{self.x(x):.1f}" cy="{self.y(y):.1f}" '
                        f'r="{r:.1f}"/>')  # fmt: skip
            case Point():
                return self._point(item)
            case Raster(row, start, length, hue):
                at = self.y(row + 0.5)
                thick = 0.72 * abs(self.y(1.0) - self.y(0.0))
                per = self.width / (self.x1 - self.x0)
                inside = (start + length > self.x0) & (start < self.x1)
                bars = "".join(
                    f"M{self.x(max(s, self.x0)):.1f} {at:.1f}h{w:.2f}"
                    for s, w in zip(
                        start[inside].tolist(),
                        np.maximum(length[inside] * per, THINNEST).tolist(),
                        strict=True,
                    )
                )
                return f'<path class="s{hue % HUES}" style="stroke-width:{thick:.1f}" d="{bars}"/>'

    def _path(self, x: Array, y: Array) -> str:
        if not self.chart.equal:
            x, y = thinned(x, y, self.chart.width)
        elif len(x) > 1500:
            x, y = x[:: len(x) // 1500 + 1], y[:: len(y) // 1500 + 1]
        pieces, pen = [], "M"
        for a, b in zip(x.tolist(), y.tolist(), strict=True):
            if math.isnan(a) or math.isnan(b):
                pen = "M"
                continue
            pieces.append(f"{pen}{self.x(a):.1f} {self.y(b):.1f}")
            pen = "L"
        return "".join(pieces)

    def _point(self, point: Point) -> str:
        a, b, hue = self.x(point.x), self.y(point.y), point.hue % HUES
        away = max(9.0, 3.0 + 0.72 * point.room * self.width / (self.x1 - self.x0))
        late = a + away + LETTER * len(point.name) > self.right  # no room on the right
        name = (f'<text class="name f{hue}" x="{a - away if late else a + away:.1f}" '
                f'y="{max(b - away, self.top + 11):.1f}" '
                f'text-anchor="{"end" if late else "start"}">'
                f"{escape(point.name)}</text>" if point.name else "")  # fmt: skip
        if point.shape == "hit":
            return (f'<path class="line hit" d="M{a - 7:.1f} {b:.1f}h14m-7 -7v14m-5 -12l10 10m0 -10'
                    f'l-10 10"/>{name}')  # fmt: skip
        if point.shape == "ring":
            return f'<circle class="line s{hue}" cx="{a:.1f}" cy="{b:.1f}" r="5"/>{name}'
        return f'<path class="line s{hue}" d="M{a - 5:.1f} {b - 5:.1f}l10 10m0 -10l-10 10"/>{name}'

    def legend(self) -> list[str]:
        out = []
        for item, at, row in self._placed():
            y = TOP + ROW * row
            out.append(f'<path class="line s{item.hue % HUES} {item.style}" '
                       f'd="M{at:.0f} {y + 4}h22"/>'
                       f'<text class="name" x="{at + 28:.0f}" y="{y + 8}">'
                       f"{escape(item.name)}</text>")  # fmt: skip
        return out

    def _placed(self) -> list[tuple[Line, float, int]]:
        """Entries of the legend, each with its position along x and its row."""
        out, at, row = [], float(self.left), 0
        for item in self.chart.items:
            if not isinstance(item, Line) or not item.name:
                continue
            wide = 28 + LETTER * len(item.name)
            if at + wide > self.right and at > self.left:
                at, row = float(self.left), row + 1
            out.append((item, at, row))
            at += wide + 18
        return out


def _range(chart: Chart) -> tuple[float, float]:
    """Range of y with a margin, limits included."""
    values: list[float] = []
    for item in chart.items:
        match item:
            case Line(_, y):
                seen = y[np.isfinite(y)]
                if len(seen):
                    values += [float(seen.min()), float(seen.max())]
            case Limit(y):
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
    air = 0.06 * (high - low) or max(abs(high), 1.0) * 0.06
    return (low if low == 0.0 else low - air), high + air
