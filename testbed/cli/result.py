"""The result of a run, printed at the terminal."""

from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table as Grid

from testbed.cli.exit_code import FAILED, FAULT, INTERRUPTED, NOT_STARTED, OK
from testbed.cli.screen import show
from testbed.config import Experiment
from testbed.core.codes import FaultId
from testbed.metrics.afterwards import left_in_words
from testbed.metrics.formation import has_formation
from testbed.metrics.run_metrics import (
    FormationCriteria,
    FormationMetrics,
    Metrics,
    weakest_jet,
)
from testbed.report.page import rounded, rows_of
from testbed.report.verdict import (
    NOTHING_MEASURED,
    NOTHING_TO_JUDGE,
    SHOWN_TOUCHES,
    UNCOUNTED,
    missed,
    touched,
    unmeasured,
)

SIMULATED = {  # behind the verdict of a rig
    "twin": " (a result of the twin, not of a table)",
    "bench": " (a result of the bench, whose table is simulated)",
}
STOP_TOOK = 0.5  # a fault that was found so long before the end gets its own time [s]


def code_of(metrics: Metrics) -> int:
    """The exit code of a run."""
    if metrics.red:
        return NOT_STARTED
    if is_stopped(metrics):
        return INTERRUPTED
    if metrics.fault:
        return FAULT
    if not metrics.completed:
        return INTERRUPTED
    return OK if all((metrics.criteria or {}).values()) else FAILED


def is_stopped(metrics: Metrics) -> bool:
    """Whether an operator ended the flight on wires; that is no fault, though it is reported so."""
    report = metrics.fault_report
    return report is not None and report.id == FaultId.STOPPED


def print_result(metrics: Metrics, experiment: Experiment, folder: Path) -> None:
    """Print a table, the verdict and the path of the run folder."""
    out = Console(highlight=False)
    if metrics.red:
        out.print(f"[bold red]not started[/]: {metrics.experiment} on the {metrics.rig}")
        out.print(f"run folder: {folder}", markup=False, soft_wrap=True)
        return
    grid = Grid(title=f"{metrics.experiment} on the {metrics.rig}, seed {metrics.seed}",
                title_justify="left", title_style="bold")  # fmt: skip
    grid.add_column("")
    for name in metrics.vehicles:
        grid.add_column(name, justify="right")
    grid.add_column("limit", justify="right", style="dim")
    together = metrics.formation
    for heading, key, scale, digits, criterion in rows_of(experiment):
        cells = [
            _cell(
                getattr(one, key), scale, digits,
                is_missed=missed(experiment, metrics, n, key, criterion),
            )
            for n, one in metrics.vehicles.items()
        ]  # fmt: skip
        grid.add_row(escape(heading), *cells, _limit(experiment, criterion, scale))
    if metrics.jets:
        shares = [_cell(weakest_jet(metrics, n), 1e2, 0, is_missed=False) for n in metrics.vehicles]
        grid.add_row(escape("weakest known jet [%]"), *shares, "")
    show(out, grid, keeps_last=True)
    separation = metrics.min_vehicle_distance_m
    pieces = [f"contacts: {'not known' if metrics.contacts == UNCOUNTED else metrics.contacts}"]
    if separation is not None:
        pieces.append(f"nearest two vehicles: {separation:.2f} m")
    if metrics.real_time_factor:
        factor = metrics.real_time_factor
        times = f"{factor:.0f}" if factor >= 10.0 else f"{factor:.2g}"
        pieces.append(f"{metrics.duration_s:.0f} s in {metrics.wall_s:.2f} s ({times} x real time)")
    out.print(", ".join(pieces))
    if together is not None and has_formation(experiment.controller):
        print_formation(out, together, experiment)
    for warning in metrics.warnings:
        out.print(f"warning: {warning.name}: {warning.text}", style="yellow", markup=False)
    for name, left in metrics.after.vehicles.items() if metrics.after is not None else ():
        bad = left.at_rest_s is None or left.air == "on"
        out.print(left_in_words(name, left), style="red" if bad else None, markup=False)
    if metrics.after is not None and metrics.after.fault is not None:
        out.print(f"the hold ended: {metrics.after.fault.words}", style="red", markup=False)
    if metrics.after is not None and metrics.after.contacts:
        words = f"contacts in the minute after the end: {metrics.after.contacts}"
        out.print(words, style="red", markup=False)
    for words in touched(experiment, metrics.touches[:SHOWN_TOUCHES]):
        out.print(words, style="red", markup=False)
    out.print(_verdict(experiment, metrics))
    out.print(f"run folder: {folder}", markup=False, soft_wrap=True)


def print_formation(out: Console, f: FormationMetrics, experiment: Experiment) -> None:
    """Print the errors of the formation and their limits."""
    limits = experiment.criteria.formation or FormationCriteria()
    pieces = [
        f"{what} {value:.3g} {unit}" + (f" (<= {limit:g})" if limit is not None else "")
        for what, value, unit, limit in (
            ("error at the end", f.error_m, "m", limits.error_m),
            ("settled after", f.settled_s, "s", limits.settled_s),
            ("longest edge", f.longest_edge_m, "m", limits.longest_edge_m),
        )
        if value is not None
    ]
    if f.error_m is not None and f.settled_s is None:
        pieces.append("never settled")
    out.print(f"formation: {', '.join(pieces) or 'no error known'}")


def _cell(value: float | None, scale: float, digits: int, *, is_missed: bool) -> str:
    words = "-" if value is None else rounded(scale * value, digits)
    return f"[red]{words}[/]" if is_missed else words


def _limit(experiment: Experiment, criterion: str, scale: float) -> str:
    if not criterion:
        return ""
    limit = getattr(experiment.criteria, criterion)
    if criterion == "clear_of_obstacles":
        radii = [obstacle.radius for obstacle in experiment.obstacles.values()]
        return f">= {max(radii):g}" if limit and radii else ""
    return "" if limit is None else f"<= {scale * limit:g}"


def _verdict(experiment: Experiment, metrics: Metrics) -> str:
    failed = [
        name + NOTHING_MEASURED * unmeasured(experiment, metrics, name)
        for name, met in (metrics.criteria or {}).items()
        if not met
    ]
    report = metrics.fault_report
    if report is not None and is_stopped(metrics):
        return f"[bold yellow]{escape(report.text)}[/] after {metrics.duration_s:.1f} s: not judged"
    if metrics.fault:
        why, end, found = escape(metrics.fault), metrics.duration_s, metrics.fault_t
        if report is not None and report.id == FaultId.PROCESS_ENDED:  # nothing tells when
            return f"[bold red]aborted[/] by a fault, the log ends at {end:.1f} s: {why}"
        at = f" at {found:.1f} s" if found is not None and end - found >= STOP_TOOK else ""
        return f"[bold red]aborted[/] after {end:.1f} s by a fault{at}: {why}"
    if not metrics.completed:
        return f"[bold yellow]interrupted[/] at {metrics.duration_s:.1f} s: not judged"
    if failed:
        return f"[bold red]failed[/]: {', '.join(failed)}"
    if not metrics.criteria:
        return f"[bold]{NOTHING_TO_JUDGE}[/]"
    return f"[bold green]passed[/]: all criteria met{SIMULATED.get(metrics.rig, '')}"
