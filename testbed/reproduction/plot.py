"""The figures of a run as charts."""

from collections.abc import Sequence
from itertools import cycle

import numpy as np

from testbed.report.axis import span
from testbed.report.item import HUES, Chart, Disc, Item, Line, Mark
from testbed.reproduction.figure import Figure

MOST = 12  # most curves in a legend
HEIGHT = 300
STYLES = ("", "dashed", "dotted")  # of the curves after the first HUES, and so on


def chart_of(
    key: str, title: str, figure: Figure, more: Sequence[Item] = (), note: str = ""
) -> Chart:
    """The chart of one figure with `more` items; positions are drawn with equal scales."""
    named = 1 < len(figure.curves) <= MOST
    items: list[Item] = [Disc(x, y, radius, "danger") for x, y, radius in figure.circles]
    items += [Line(x, y, 0, "", "way dashed") for x, y in figure.ways]
    styles = (style for style in cycle(STYLES) for _ in range(HUES))
    for k, ((name, (x, y)), style) in enumerate(zip(figure.curves.items(), styles, strict=False)):
        items.append(Line(x, y, k, name if named else "", style))
        if figure.dots and len(x):
            items.append(Mark(float(x[-1]), float(y[-1]), name, case=0, style="rest"))
    items += [Line(x, y, 0, "", "edge dashed") for x, y in figure.shapes]
    rims = [((x - r, x + r), (y - r, y + r)) for x, y, r in figure.circles]
    drawn = [*figure.curves.values(), *figure.shapes, *figure.ways, *rims]
    x_range, y_range = (_span([np.asarray(curve[k]) for curve in drawn]) for k in (0, 1))
    if figure.dots:
        half = 0.52 * max(x_range[1] - x_range[0], y_range[1] - y_range[0])
        x_range, y_range = ((0.5 * sum(r) - half, 0.5 * sum(r) + half) for r in (x_range, y_range))
    notes = [note, *(words for words, some in (
        ("Dashed red circles: danger radii.", figure.circles),
        ("Dashed red lines: their paths; they are drawn where they end.", figure.ways),
        ("Dashed grey: the curve to form.", figure.shapes)) if some)]  # fmt: skip
    return Chart(key, f"{title}: {figure.name}", figure.x, figure.y, [*items, *more], x_range,
                 y_range if figure.dots else None, log=figure.log, equal=figure.dots,
                 height=HEIGHT, note=" ".join(filter(None, notes)))  # fmt: skip


def _span(values: list[np.ndarray]) -> tuple[float, float]:
    every = np.concatenate([np.asarray(one, float) for one in values] or [np.zeros(1)])
    seen = every[np.isfinite(every)]
    return span((seen if len(seen) else np.zeros(1)).tolist(), room=0.0)
