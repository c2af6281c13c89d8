"""The page of `testbed validate`: the verdict with figures."""

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from testbed.core.error import TestbedError
from testbed.identification.validation import HorizonErrors
from testbed.report.chart import Chart, Limit, Line
from testbed.report.page import figure, page

NAMES = {"vehicle": "file under test", "against": "compared file"}


def write_page(
    path: Path, title: str, result: dict[str, Any], errors: dict[str, list[HorizonErrors]]
) -> None:
    """Write the page.

    Raises:
        TestbedError: the path cannot be written.
    """
    rows = "".join(
        f"<tr><td>{h} s</td><td>{NAMES[who]}</td>{_cells(figures)}</tr>"
        for h, both in result["horizons"].items()
        for who, figures in both.items()
    )
    table = (
        '<div class="wide"><table><tr><th>ahead</th><th>vehicle file</th><th>position RMS [mm]</th>'
        "<th>median [mm]</th><th>heading RMS [deg]</th><th>predictions</th></tr>"
        f"{rows}</table></div>"
    )
    noise = result["noise"]
    words = (
        f"<p>{escape(result['verdict'])}</p><p>Noise of a pose: {1e3 * noise['position_m']:.2g} mm,"
        f" {noise['heading_deg']:.2g} deg. A prediction starts from the poses of the second before"
        " it and the commands; it sees nothing later.</p>"
    )
    warnings = [f"{one['name']}: {one['text']}" for one in result.get("suspicions", ())]
    warnings += [f"{name}: the fit has seen this log" for name in result.get("seen_by_the_fit", ())]
    words += "".join(f"<p>Warning: {escape(text)}</p>" for text in warnings)
    if compared := result.get("files", {}).get("against"):
        words += f"<p>The compared file is {escape(str(compared))}.</p>"
    drawn = "".join(figure(chart) for chart in _charts(errors, noise["position_m"]))
    body = f"<h1>{escape(title)}</h1>{words}{table}<div class='figures'>{drawn}</div>"
    try:
        path.write_text(page(title, body), encoding="utf-8")
    except OSError as error:
        raise TestbedError(
            where=str(path), expected="a writable path", found=error.strerror or str(error)
        ) from None


def _cells(figures: dict[str, Any]) -> str:
    if not figures["count"]:
        return "<td></td><td></td><td></td><td>0</td>"
    return (
        f"<td>{1e3 * figures['position_rms_m']:.1f}</td>"
        f"<td>{1e3 * figures['position_median_m']:.1f}</td>"
        f"<td>{figures['heading_rms_deg']:.2f}</td><td>{figures['count']}</td>"
    )


def _charts(errors: dict[str, list[HorizonErrors]], noise: float) -> Sequence[Chart]:
    charts = []
    for k, own in enumerate(errors["vehicle"]):
        if not len(own.t):
            continue
        items: list[Any] = [Limit(1e3 * noise, "noise of a pose")] if noise > 0.0 else []
        spread = []
        for hue, (who, found) in enumerate(errors.items()):
            ahead = found[k]
            order = np.argsort(ahead.t, kind="stable")
            size = 1e3 * np.hypot(ahead.error[:, 0], ahead.error[:, 1])[order]
            gap = np.diff(ahead.t[order], prepend=ahead.t[order][0]) > 1.0
            items.append(Line(ahead.t[order], np.where(gap, np.nan, size), hue, NAMES[who]))
            share = np.linspace(0.0, 100.0, len(size))
            spread.append(Line(np.sort(size), share, hue, NAMES[who]))
        h = f"{own.horizon:g}"
        span = float(own.t.min()), float(max(own.t.max(), own.t.min() + 1.0))
        charts.append(
            Chart(f"error_{h}s", f"Error {h} s ahead", "t [s]", "error [mm]", items, span)
        )
        largest = max(float(line.x.max()) for line in spread)
        charts.append(
            Chart(
                f"share_{h}s",
                f"Share of predictions with a smaller error, {h} s ahead",
                "error [mm]",
                "share [%]",
                spread,
                (0.0, max(largest, 1e-3)),
            )
        )
    return charts
