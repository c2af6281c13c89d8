"""Parts of a chart: lines, limits, marks, boxes, words, axes."""

from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

Array = NDArray[np.float64]

WIDTH = 600  # of a figure; it scales with the page
HUES = 8  # of theme.css; the console and the dashboard have as many


class Line(Struct, frozen=True):
    """A series of points; NaN interrupts the line."""

    x: Array
    y: Array
    hue: int
    name: str = ""  # in the legend
    style: str = ""  # thin, dashed, dotted
    hint: str = ""  # name of a line that is not in the legend, for its value at the cursor


class Limit(Struct, frozen=True):
    """A horizontal line at a limit of y."""

    y: float
    name: str
    style: str = ""  # value: what was measured


class Moment(Struct, frozen=True):
    """A vertical line at the time of an event."""

    x: float
    name: str
    style: str = ""  # mild: not a fault


class Disc(Struct, frozen=True):
    """A circle in the figure's units."""

    x: float
    y: float
    radius: float
    style: str  # danger, solid, or ghost with a hue
    hue: int = 0


class Point(Struct, frozen=True):
    """A named point of a chart."""

    x: float
    y: float
    hue: int
    shape: str  # ring: a start; cross: a goal; hit: a contact; fault
    name: str = ""
    room: float = 0.0  # radius of the object, which the name stays outside of


class Raster(Struct, frozen=True):
    """One row of bars, such as a valve's pulses."""

    row: int
    start: Array
    length: Array
    hue: int


class Mark(Struct, frozen=True):
    """One of many results: a disc or a cross, or the colour and shape of its case."""

    x: float
    y: float
    hint: str = ""  # shown under the pointer
    passed: bool = True  # failed: a cross; with a case hollow, so that colour is not the only cue
    case: int | None = None
    style: str = ""  # full, best, rest
    radius: float = 3.0
    shift: float = 0.0  # to the right [px]


class Key(Struct, frozen=True):
    """An entry of the legend for marks."""

    name: str
    case: int | None  # None: the hollow mark


class Box(Struct, frozen=True):
    """A rectangle in the figure's units: a bar of a histogram, a field of a map."""

    x: tuple[float, float]
    y: tuple[float, float]
    style: str  # good, bad, heat, or full or open with a hue
    hint: str = ""
    hue: int | None = None
    words: str = ""
    share: float = 0.0  # of a field of a map: darkness, 0 to 1


class Words(Struct, frozen=True):
    """Text at a point of a chart."""

    x: float
    y: float
    text: str
    anchor: str = "start"
    style: str = ""  # name: dark
    shift: float = 0.0  # to the right [px]


Item = Line | Limit | Moment | Disc | Point | Raster | Mark | Key | Box | Words
Labels = Sequence[tuple[float, str]]


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
    x_log: bool = False
    whole: bool = False  # y counts
    equal: bool = False  # equal scales of x and y; the range is a table
    x_ticks: Labels | None = None  # None: round numbers with grid lines
    y_ticks: Labels | None = None
    side: Labels = ()  # labels at the right
    height: int = 210
    width: int = WIDTH
    note: str = ""  # below the figure
