"""The layout of the dashboard: the table on the left, plots on the right."""

import math

import rerun.blueprint as rrb
from rerun.blueprint.archetypes import (
    EyeControls3D,
    LineGrid3D,
)
from rerun.blueprint.encodings import TimelineColumn

from testbed.config.experiment import Experiment
from testbed.dashboard import legend
from testbed.dashboard.banner import HEIGHT, WIDTH
from testbed.dashboard.static_scene import plain
from testbed.report.goal_error import GoalError

FIELD = 57.0  # [deg] vertical, of rerun's eye
WINDOW_S = 60.0  # of the plots
VALVES_S = 10.0
MOST_ROWS = 4  # of the valves that their title names


def blueprint(scenario: Experiment, *, live: bool) -> rrb.Blueprint:
    """The views, and a time panel that follows a live flight or is paused for replay."""
    half = max(scenario.table.size) / 2
    height = 1.08 * half / math.tan(math.radians(FIELD / 2))
    top = rrb.Spatial3DView(
        origin="/world", name=f"Table from above, {scenario.table.size[0]:g} m x "
        f"{scenario.table.size[1]:g} m, grid 1 m", background=[16, 20, 26],
        eye_controls=EyeControls3D(
            position=(0, 0, height), look_target=(0, 0, 0), eye_up=(0, 1, 0),
            kind=rrb.Eye3DKind.Orbital),
        line_grid=LineGrid3D(visible=True, spacing=1.0, color=[60, 68, 80]),
    )  # fmt: skip
    flight = rrb.Vertical(
        _plot("error", f"{GoalError(scenario).title} [mm] over time [s]"),
        _plot("clearance", "Clearance to the nearest danger zone [m] over time [s]")
        if scenario.obstacles
        else _plot("speed", "Speed [mm/s] over time [s]"),
        _plot("force", "Force demanded and delivered, mean over 1 s [N] over time [s]"),
        _valve_rows(scenario, WINDOW_S),
        row_shares=[3, 3, 3, 4],
        name="Flight",
    )
    air = rrb.Vertical(
        _plot("gas", "Gas left [%] over time [s]"),
        _plot("supply", "Supply pressure [kPa] over time [s]"),
        _plot("speed", "Speed [mm/s] over time [s]"),
        _plot("filter", "Force changed by the safety filter [N] over time [s]"),
        name="Air and safety",
    )
    timing = rrb.Vertical(
        _plot("pose_age", "Age of the newest pose [ms] over time [s]"),
        _plot("link", "Link delay: age of the newest state at the host [ms] over time [s]"),
        _plot("loss", "Link loss: ticks without a new message [%] over time [s]"),
        _plot("loop", "Loop lateness [ms] over time [s]", legend=True),
        name="Timing",
    )
    valves = rrb.Vertical(
        _valve_rows(scenario, VALVES_S),
        *[
            rrb.StateTimelineView(
                origin=f"/valve/{name}", name=f"Valves of {plain(name)} over time [s]",
                time_ranges=_window(VALVES_S))
            for name in scenario.vehicles
        ],
        name="Valves",
    )  # fmt: skip
    left = rrb.Vertical(
        rrb.Spatial2DView(
            origin="/banner",
            name="State",
            titlebar=False,
            background=[16, 20, 26],
            visual_bounds=rrb.VisualBounds2D(x_range=[0, WIDTH], y_range=[0, HEIGHT]),
        ),
        top,
        rrb.TextLogView(
            origin="/event",
            name="Events, time [s]",
            columns=rrb.TextLogColumns(
                timeline_columns=[TimelineColumn("t", visible=False)],
                text_log_columns=["LogLevel", "Body"],
            ),
        ),
        row_shares=[0.75, 9, 2.4],
    )
    right = rrb.Vertical(
        rrb.Spatial2DView(
            origin="/legend", name="Legend", titlebar=False, background=[16, 20, 26],
            visual_bounds=rrb.VisualBounds2D(
                x_range=[0, legend.WIDTH], y_range=[0, legend.HEIGHT]
            ),
        ),
        rrb.Tabs(flight, air, timing, valves),
        row_shares=[0.5, 11],
    )  # fmt: skip
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[11, 9]),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(
            state="collapsed", timeline="t", play_state="following" if live else "playing"
        ),
        rrb.TopPanel(state="hidden"),
        auto_views=False,
        auto_layout=False,
    )


def _window(seconds: float) -> list[rrb.VisibleTimeRange]:
    return [
        rrb.VisibleTimeRange(
            "t",
            start=rrb.TimeRangeBoundary.cursor_relative(seconds=-seconds),
            end=rrb.TimeRangeBoundary.cursor_relative(),
        )
    ]


def _valve_rows(scenario: Experiment, seconds: float) -> rrb.TimeSeriesView:
    rows = [f"{10 * k + 1}: {plain(n)} jet 1" for k, n in enumerate(scenario.vehicles, 1)]
    first = ", ".join(rows if len(rows) <= MOST_ROWS else [*rows[:2], "...", rows[-1]])
    top = 10.0 * (len(scenario.vehicles) + 1)
    return rrb.TimeSeriesView(
        origin="/plot/valve", name=f"Valves, a dot per pulse, {seconds:g} s; row {first}",
        time_ranges=_window(seconds), plot_legend=rrb.PlotLegend(visible=False),
        axis_y=rrb.ScalarAxis(range=(10.0, top), zoom_lock=True),
    )  # fmt: skip


def _plot(what: str, name: str, *, legend: bool = False) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=f"/plot/{what}", name=name, time_ranges=_window(WINDOW_S),
        plot_legend=rrb.PlotLegend(visible=legend, corner="LeftTop"),
    )  # fmt: skip
