"""`testbed calibrate slope`: a measured slope map as a table, and the page of any slope map."""

from pathlib import Path

import numpy as np
from msgspec import structs

from testbed.core.error import TestbedError
from testbed.core.table import Table
from testbed.identification.columns import LogRefusedError, NumericColumns
from testbed.identification.prediction import Array
from testbed.report.chart import Box, Chart, Line
from testbed.report.page import figure, page

ACCELERATIONS = {"m/s^2": 1.0, "mm/s^2": 1e-3, "rad": 9.80665}
STEEPEST = 1.0  # [m/s^2]; a table is far flatter
ARROW = 0.45  # of a field: length of the longest


def measured_map(columns: NumericColumns, names: tuple[str, str, str, str], unit: str) -> Table:
    """Slope from a CSV with one row per node of an even grid around the table's middle.

    Args:
        columns: of the CSV.
        names: columns of x, y [m] and of the slope along x and y.
        unit: of the slopes: acceleration of a floating body, or angle.

    Raises:
        LogRefusedError: the nodes are not an even grid, or the slopes are too steep.
    """
    from testbed.identification.table_file import load_table

    x, y, *slopes = (columns.whole(name) for name in names)
    places = [np.unique(np.round(one, 6)) for one in (x, y)]
    shape = len(places[1]), len(places[0])
    even = all(len(p) > 1 and np.ptp(np.diff(p)) < 1e-3 * np.ptp(p) for p in places)
    middle = all(abs(p[0] + p[-1]) < 1e-3 * np.ptp(p) for p in places)
    if not (even and middle and len(x) == shape[0] * shape[1]):
        raise LogRefusedError(
            where=columns.where, expected="one row per node of an even grid around (0, 0)",
            found=f"{len(x)} rows, {shape[1]} different x, {shape[0]} different y",
        )  # fmt: skip
    grid = np.zeros((*shape, 2))
    at = np.searchsorted(places[1], np.round(y, 6)), np.searchsorted(places[0], np.round(x, 6))
    rows = np.zeros(shape, dtype=int)
    np.add.at(rows, at, 1)
    if not rows.all():
        j, i = np.argwhere(rows == 0)[0]
        first = int(np.argmax(rows[at] > 1)) + 1
        raise LogRefusedError(
            where=columns.where, expected="one row per node",
            found=f"no row at ({places[0][i]:g}, {places[1][j]:g}), two at"
            f" ({x[first - 1]:g}, {y[first - 1]:g}), one of them is data row {first}",
        )  # fmt: skip
    for axis, slope in enumerate(slopes):
        grid[(*at, axis)] = slope * ACCELERATIONS[unit]
    if np.abs(grid).max() > STEEPEST:
        raise LogRefusedError(
            where=columns.where, expected=f"slopes up to {STEEPEST:g} m/s^2",
            found=f"{np.abs(grid).max():.3g} m/s^2", hint=f"is the unit {unit}?",
        )  # fmt: skip
    size = float(np.ptp(places[0])), float(np.ptp(places[1]))
    return with_map(load_table(None), grid, size)


def with_map(table: Table, grid: Array, size: tuple[float, float]) -> Table:
    """The table with this size and map, (rows, columns, 2) [m/s^2]."""
    rows = [[(float(a[0]), float(a[1])) for a in row] for row in grid]
    return structs.replace(
        table, size=size, tilt=structs.replace(table.tilt, uniform=(0.0, 0.0), map=rows)
    )


def write_slope_page(path: Path, title: str, table: Table, sigma: Array | None = None) -> None:
    """Write a page with the map: steepness and direction, and its uncertainty if known.

    Raises:
        TestbedError: the path cannot be written.
    """
    grid = np.array(table.tilt.map)
    size = np.hypot(grid[..., 0], grid[..., 1])
    charts = [_chart("slope", "Slope: darker is steeper, lines point down", table, size, grid)]
    if sigma is not None:
        wide = np.hypot(sigma[..., 0], sigma[..., 1])
        charts.append(_chart("sigma", "Standard deviation of the slope", table, wide, None))
    words = (
        f"<p>{grid.shape[1]} x {grid.shape[0]} nodes on {table.size[0]:g} m x {table.size[1]:g} m:"
        f" median {1e3 * np.median(size):.1f} mm/s^2, largest {1e3 * size.max():.1f} mm/s^2.</p>"
    )
    drawn = "".join(figure(chart) for chart in charts)
    try:
        body = f"<h1>{title}</h1>{words}<div class='figures'>{drawn}</div>"
        path.write_text(page(title, body), encoding="utf-8")
    except OSError as error:
        raise TestbedError(
            where=str(path), expected="a writable path", found=error.strerror or str(error)
        ) from None


def _chart(key: str, title: str, table: Table, size: Array, arrows: Array | None) -> Chart:
    rows, columns = size.shape
    wide, high = table.size[0] / (columns - 1), table.size[1] / (rows - 1)
    steepest = max(float(size.max()), 1e-9)
    items: list[Box | Line] = []
    for j in range(rows):
        for i in range(columns):
            x, y = -0.5 * table.size[0] + i * wide, -0.5 * table.size[1] + j * high
            hint = f"({x:.2f}, {y:.2f}) m: {1e3 * size[j, i]:.1f} mm/s^2"
            edges = (x - wide / 2, x + wide / 2), (y - high / 2, y + high / 2)
            items.append(Box(*edges, "heat", hint, share=float(size[j, i]) / steepest))
            if arrows is not None:
                ax, ay = arrows[j, i] / steepest * 2.0 * ARROW * min(wide, high)
                items.append(Line(np.array([x, x + ax]), np.array([y, y + ay]), 0, style="thin"))
    half = 0.5 * (table.size[0] + wide), 0.5 * (table.size[1] + high)
    return Chart(
        key, title, "x [m]", "y [m]", items, (-half[0], half[0]), (-half[1], half[1]), equal=True,
        height=480, width=520,
    )  # fmt: skip
