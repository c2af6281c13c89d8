"""The figures of a fork, with the run that it was made from."""

from collections.abc import Sequence
from typing import NamedTuple

from msgspec.structs import replace

from testbed.logs.history import History
from testbed.report.item import Chart, Item, Line, Moment


class Original(NamedTuple):
    """The run that a fork was made from."""

    name: str
    t: float  # of the fork [s]
    history: History


def with_original(
    charts: Sequence[Chart], before: Sequence[Chart], original: Original
) -> list[Chart]:
    """The figures with the lines of the original, dotted, and the time of the fork."""
    by_key = {chart.key: chart for chart in before}
    return [_both(chart, by_key.get(chart.key), original) for chart in charts]


def _both(chart: Chart, before: Chart | None, original: Original) -> Chart:
    lines: list[Item] = [
        replace(one, name="", style="dotted")
        for one in (before.items if before else ())
        if isinstance(one, Line) and one.style == ""
    ]
    if not lines:
        return chart
    if chart.x_label.startswith("time"):
        lines.append(Moment(original.t, "fork"))
    note = f"{chart.note} Dotted: {original.name}, from which this run was forked.".strip()
    return replace(chart, items=[*lines, *chart.items], note=note)
