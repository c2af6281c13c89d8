"""`testbed compare`: several runs side by side, in a table and as figures on one page."""

from collections.abc import Sequence
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from rich.console import Console
from rich.table import Table as Grid
from rich.text import Text

from testbed.cli.compare_paper import (
    PaperRow,
    Printed,
    paper_rows,
    paper_table,
    printed_about,
    with_paper,
)
from testbed.cli.exit_code import OK
from testbed.cli.refusal import refuse, warn
from testbed.cli.screen import print_json, show
from testbed.config import ConfigError, Experiment, load
from testbed.logs.history import History
from testbed.logs.log_reader import LogError, config_of, log_of
from testbed.metrics.formation import has_formation
from testbed.metrics.run_metrics import Metrics
from testbed.report.chart import TIME
from testbed.report.events import lines
from testbed.report.goal_error import GoalError
from testbed.report.item import HUES, Chart, Disc, Item, Limit, Line
from testbed.report.page import (
    DASH,
    OF_A_GOAL,
    ROWS,
    SCRIPT,
    ReportError,
    figure,
    page,
    rounded,
    together_of,
)
from testbed.report.scrubber import LONGEST, bar, flight_data, vehicle_data
from testbed.report.verdict import NOTHING_TO_JUDGE, UNCOUNTED
from testbed.run.recorded import recorded

TOGETHER = {  # key of a row, of the formation's metrics
    "formation_error_m": "error_m", "formation_settled_s": "settled_s",
    "longest_edge_m": "longest_edge_m",
}  # fmt: skip
FORMATION_ROWS = (
    ("formation error [mm]", "formation_error_m", 1e3, 1, ""),
    ("formation settled [s]", "formation_settled_s", 1.0, 1, ""),
    ("longest edge [m]", "longest_edge_m", 1.0, 2, ""),
)
STYLES = ("", "dashed", "dotted")  # keeps identical curves visible
FIRST_COLUMN = 25  # width of the first column and its frame [characters]


class ComparedRun(msgspec.Struct, frozen=True):
    """One of the runs that are compared."""

    label: str
    experiment: Experiment
    history: History
    metrics: Metrics


def compare_runs(
    folders: Sequence[Path], out: Path | None, as_json: bool, paper: bool = False
) -> int:
    """Print the table and write the page; with `paper` also what the paper prints."""
    try:
        names = [folder.resolve().name for folder in folders]
        same = len(set(names)) < len(names)
        runs = [
            read_run(folder, str(folder) if same else name)
            for folder, name in zip(folders, names, strict=True)
        ]
        printed = printed_about(runs[0].experiment.name) if paper else None
        if out is not None:
            with out.open("x", encoding="utf-8") as file:
                file.write(render(runs, printed))
    except (ReportError, LogError, ConfigError, OSError) as error:
        return refuse(error)
    if as_json:
        rows = rows_for(runs)
        found = {run.label: {key: worst(run, key) for _, key, *_ in rows} for run in runs}
        print_json(found)
    else:
        print_table(runs)
        if printed is not None:
            print_paper(runs, printed)
        if out is not None:
            Console(highlight=False).print(str(out), markup=False, soft_wrap=True)
    return OK


def read_run(folder: Path, label: str) -> ComparedRun:
    """Read metrics and log of a run folder."""
    log, experiment = log_of(folder), load(config_of(folder))
    history, metrics, _ = recorded(log, experiment, warn)
    return ComparedRun(label, experiment, history, metrics)


def rows_for(runs: Sequence[ComparedRun]) -> Sequence[tuple[str, str, float, int, str]]:
    """Rows of the table; formation rows only if a run flies a formation."""
    some = any(has_formation(run.experiment.controller) for run in runs)
    return (*FORMATION_ROWS, *ROWS) if some else ROWS


def worst(run: ComparedRun, key: str) -> float | None:
    """The worst value of all vehicles (the smallest distance), or the formation's own value."""
    if key in TOGETHER:
        return getattr(together_of(run.experiment, run.metrics), TOGETHER[key], None)
    if key in OF_A_GOAL and has_formation(run.experiment.controller):
        return None
    values = [getattr(one, key) for one in run.metrics.vehicles.values()]
    there = [v for v in values if v is not None]
    if len(there) < len(values) or not there:
        return None
    return min(there) if key.startswith("min_") else max(there)


def print_table(runs: Sequence[ComparedRun]) -> None:
    """Print one column per run, the worst vehicle in each row; long names become numbers."""
    out = Console(highlight=False)
    fits = FIRST_COLUMN + sum(len(run.label) + 3 for run in runs) <= out.width
    if not fits:
        for k, run in enumerate(runs, 1):
            out.print(f"{k:3}  {run.label}", markup=False, soft_wrap=True)
    grid = Grid(title="worst vehicle of each run", title_justify="left")
    grid.add_column("")
    for k, run in enumerate(runs, 1):
        grid.add_column(run.label if fits else str(k), justify="right")
    for heading, key, scale, digits, _ in rows_for(runs):
        cells = [worst(run, key) for run in runs]
        words = ["-" if v is None else rounded(scale * v, digits) for v in cells]
        grid.add_row(heading.replace("[", "\\["), *words)
    grid.add_row("verdict", *[verdict(run.metrics) for run in runs])
    show(out, grid)


def rows_of_paper(runs: Sequence[ComparedRun], printed: Printed) -> list[PaperRow]:
    """The paper's numbers beside the runs'."""
    values = [partial(_value, run) for run in runs]
    return paper_rows(printed, values, [run.history for run in runs])


def _value(run: ComparedRun, measure: str) -> float | None:
    """The worst vehicle's measure, by its name in a paper's file."""
    if measure == "contacts":
        return None if run.metrics.contacts == UNCOUNTED else float(run.metrics.contacts)
    if measure == "vehicles_m":
        return run.metrics.min_vehicle_distance_m
    return worst(run, measure)


def print_paper(runs: Sequence[ComparedRun], printed: Printed) -> None:
    """Print the paper's numbers beside the runs'."""
    out = Console(highlight=False)
    grid = Grid(title=f"{printed.key}, and the runs; in brackets: less the paper's",
                title_justify="left")  # fmt: skip
    for heading in ("where", "what", "paper"):
        grid.add_column(heading, overflow="fold")
    for k, run in enumerate(runs, 1):
        grid.add_column(run.label if len(run.label) <= FIRST_COLUMN else str(k), justify="right")
    for row in rows_of_paper(runs, printed):
        grid.add_row(*(Text(cell) for cell in (row.source, row.what, row.paper, *row.values)))
    show(out, grid)


def verdict(metrics: Metrics) -> str:
    """The verdict as one short phrase."""
    if metrics.contacts == UNCOUNTED:
        return "not judged"
    if metrics.red:
        return "not started"
    if metrics.fault:
        return "aborted"
    if not metrics.completed:
        return "interrupted"
    if not metrics.criteria:
        return NOTHING_TO_JUDGE
    return "passed" if all(metrics.criteria.values()) else "failed"


def render(runs: Sequence[ComparedRun], printed: Printed | None = None) -> str:
    """The page: a table, then the figures with all runs overlaid, one colour per run."""
    drawn, beside = charts(runs), ""
    if printed is not None:
        drawn = with_paper(drawn, printed)
        rows_ = rows_of_paper(runs, printed)
        beside = paper_table(printed, [run.label for run in runs], rows_)
    heads = "".join(
        f'<th><span class="dot" style="background:var(--h{k % HUES})"></span>'
        f"{escape(run.label)}</th>"
        for k, run in enumerate(runs)
    )
    rows = []
    for heading, key, scale, digits, _ in rows_for(runs):
        cells = [worst(run, key) for run in runs]
        words = "".join(
            f"<td>{DASH if v is None else rounded(scale * v, digits)}</td>" for v in cells
        )
        rows.append(f"<tr><td>{heading}, worst vehicle</td>{words}</tr>")
    rows.append(
        "<tr><td>verdict</td>" + "".join(f"<td>{verdict(r.metrics)}</td>" for r in runs) + "</tr>"
    )
    figures = "".join(map(figure, drawn))
    data = together_data(runs)
    return page(
        "Comparison",
        f"<header><div><h1>Comparison of {len(runs)} runs</h1></div></header>"
        f'<div class="wide"><table><tr><th>number</th>{heads}</tr>{"".join(rows)}</table></div>'
        f"{beside}"
        f'<h2>Figures</h2><div class="figures">{figures}</div>{bar(data)}',
        script=SCRIPT,
    )


def together_data(runs: Sequence[ComparedRun]) -> dict[str, Any]:
    """The scrubber's data: the vehicles of all runs on one table, one colour per run."""
    longest = max(runs, key=lambda run: run.history.end)
    data = flight_data(longest.experiment, longest.history)
    data["vehicles"] = [
        vehicle_data(run.experiment, run.history, name, k, data["step"])
        | {"name": f"{run.label}: {name}"}
        for k, run in enumerate(runs)
        for name in run.history.vehicles
    ]
    data["events"] = sorted(
        [round(one.t, 2), one.level, f"{run.label}: {', '.join(one.who)}", one.words[:LONGEST]]
        for run in runs
        for one in lines(run.experiment, run.history, run.metrics.touches)
        if one.level != "INFO"
    )
    return data


def charts(runs: Sequence[ComparedRun]) -> list[Chart]:
    """Figures with all runs overlaid; the table and obstacles are those of the first run."""
    first = runs[0].experiment
    half_x, half_y = first.table.size[0] / 2, first.table.size[1] / 2
    tracks: list[Item] = [
        Disc(*obstacle.position, obstacle.radius, "danger") for obstacle in first.obstacles.values()
    ]
    errors_: list[Item] = []
    clear: list[Item] = []
    speeds: list[Item] = []
    gas: list[Item] = []
    places_: tuple[list[Item], list[Item]] = [], []
    titles: list[str] = []
    end = max(run.history.end for run in runs)
    for k, run in enumerate(runs):
        obstacles, asked = list(run.experiment.obstacles.values()), GoalError(run.experiment)
        titles.append(asked.title)
        style = STYLES[k % len(STYLES)]
        times, places = run.history.together()
        for n, (part, off) in enumerate(asked.parts(times, places).items()):
            label, hint = run.label if n == 0 else "", f"{run.label}: {part}"
            errors_.append(Line(times, 1e3 * off, k, label, style, hint))
        for n, (name, vehicle) in enumerate(run.history.vehicles.items()):
            label = run.label if n == 0 else ""
            t, state = run.history.where(name)
            hint = f"{run.label}: {name}"
            tracks.append(Line(state[:, 0], state[:, 1], k, label, style, hint))
            speeds.append(Line(t, 1e3 * np.hypot(*state[:, 3:5].T), k, label, style, hint))
            if np.any(vehicle.tank > 0.0):  # otherwise it has no pressure gauge
                gas.append(Line(vehicle.t, vehicle.tank / 1e6, k, label, style, hint))
            for axis, axis_lines in enumerate(places_):
                axis_lines.append(Line(t, state[:, axis], k, label, style, hint))
            if obstacles:
                gaps = [
                    np.hypot(*(state[:, :2] - np.array(r.position) - np.outer(t, r.velocity)).T)
                    - r.radius
                    for r in obstacles
                ]
                clear.append(Line(t, np.min(gaps, axis=0), k, label, style, hint))
    span = (0.0, max(end, 1e-3))
    made = [
        Chart("trajectory", "Trajectories", "x [m]", "y [m]", tracks, (-half_x, half_x),
              (-half_y, half_y), equal=True),
        *(Chart(f"position_{axis}", f"Position {axis}", TIME, f"{axis} [m]", one, span)
          for axis, one in zip("xy", places_, strict=True)),
        *residuals(runs, span),
        Chart("error", "; ".join(dict.fromkeys(titles)), "time [s]",
              "distance [mm], log scale", errors_, span, log=True),
        Chart("speed", "Speed", "time [s]", "speed [mm/s]", speeds, span),
        Chart("tank", "Gas left: tank pressure", "time [s]", "pressure [MPa]", gas, span),
    ]  # fmt: skip
    if clear:
        limit = Limit(0.0, "danger radius")
        made.append(
            Chart("obstacles", "Distance to the nearest danger zone", "time [s]", "distance [m]",
                  [*clear, limit], span)
        )  # fmt: skip
    return [one for one in made if one.items]


def residuals(runs: Sequence[ComparedRun], span: tuple[float, float]) -> list[Chart]:
    """Differences to the first run, of vehicles with the same name, at the same times."""
    first, apart, turns = runs[0], list[Item](), list[Item]()
    for k, run in enumerate(runs[1:], 1):
        shared = [name for name in run.history.vehicles if name in first.history.vehicles]
        for n, name in enumerate(shared):
            (t, state), (t0, state0) = run.history.where(name), first.history.where(name)
            if len(t) < 2 or len(t0) < 2:
                continue
            inside = (t >= t0[0]) & (t <= t0[-1])
            there = np.column_stack(
                [np.interp(t[inside], t0, np.unwrap(state0[:, i]) if i == 2 else state0[:, i])
                 for i in range(3)]
            )  # fmt: skip
            off = state[inside, :3] - there
            turn = np.degrees(np.angle(np.exp(1j * off[:, 2])))
            label, style = run.label if n == 0 else "", STYLES[k % len(STYLES)]
            hint = f"{run.label}: {name}"
            distance = 1e3 * np.hypot(*off[:, :2].T)
            apart.append(Line(t[inside], distance, k, label, style, hint))
            turns.append(Line(t[inside], turn, k, label, style, hint))
    title = f"to {first.label}"
    return [
        Chart("residual", f"Residual: distance {title}", TIME, "distance [mm]", apart, span),
        Chart("residual_turn", f"Residual: heading {title}", TIME, "angle [deg]", turns, span),
    ]
