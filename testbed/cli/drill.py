"""`testbed drill`: inject every kind of fault and print the outcomes."""

from collections.abc import Sequence

import msgspec
from msgspec.structs import replace
from rich.console import Console
from rich.markup import escape
from rich.table import Table as Grid

from testbed.cli.exit_code import FAILED, OK
from testbed.cli.refusal import errors, refuse
from testbed.cli.screen import print_json, print_text, show
from testbed.cli.tracked import tracked
from testbed.config import ConfigError, find, load
from testbed.faults.catalogue import CATALOGUE
from testbed.faults.drill import (
    Drill,
    Drilled,
    cases_of,
    summarise,
)
from testbed.run.drill import EXPERIMENTS, drill_twin

HEADINGS = (  # numeric columns, narrow so that the table fits into 80 columns
    "n", "not\nfound", "may\npass", "does\n[s]", "worst\n[s]", "shut\n[s]", "moved\n[m]",
    "con-\ntacts", "a-\ndrift", "open\nlate", "na-\nmed",
)  # fmt: skip


def run_drill(
    rig: str, injections: int | None, seed: int, jobs: int, as_json: bool,
    experiment: str | None = None,
) -> int:  # fmt: skip
    """Fly the drill and print the table; return the exit code."""
    names = EXPERIMENTS if experiment is None else (experiment,)
    try:
        first = load(find(names[0]))  # an error now, not in a worker
        if rig == "bench":
            from testbed.run.drill_on_wires import drill_wires

            count = injections or len(cases_of(rig, len(first.vehicles)))
            found = tracked(drill_wires(count, seed, report, names[0]), "drilling", count)
        else:
            count = injections or 540
            found = tracked(drill_twin(count, seed, jobs, names), "drilling", count)
        cases = list(found)
    except ConfigError as error:
        return refuse(error)
    drill = summarise(rig, cases)
    if as_json:
        print_json(drill)
    else:
        print_drill(drill, cases)
    clean = not (drill.undetected or drill.valves_open_after_deadline or drill.contacts)
    return OK if clean else FAILED


def report(line: str) -> None:
    """Print progress on standard error; standard output is for the result."""
    print_text(errors, line)


def print_drill(drill: Drill, cases: Sequence[Drilled]) -> None:
    """Print the table and every failed case."""
    out = Console(highlight=False)
    title = f"{drill.injections} injected faults on the {drill.rig}"
    grid = Grid(
        title=title, title_justify="left", title_style="bold", box=None, padding=(0, 1, 0, 0)
    )
    for heading in ("fault", "does"):
        grid.add_column(heading)
    for heading in HEADINGS:
        grid.add_column(escape(heading), justify="right")
    for row in drill.rows:
        bad = row.undetected or row.contacts or row.valves_open_after_deadline
        grid.add_row(
            row.kind, row.response or "-", str(row.cases), str(row.undetected),
            str(row.dormant + row.unnoticed), _number(row.detected_median_s),
            _number(row.detected_worst_s), _number(row.shut_worst_s),
            _number(row.travelled_worst_m), str(row.contacts), str(row.adrift),
            str(row.valves_open_after_deadline), f"{row.rightly}/{row.judged}",
            style="red" if bad else None,
        )  # fmt: skip
    show(out, grid)
    out.print(
        f"undetected: {drill.undetected}, without effect: {drill.dormant}, "
        f"unnoticed but allowed: {sum(row.unnoticed for row in drill.rows)}, "
        f"valves open after the deadline: {drill.valves_open_after_deadline}, "
        f"contacts: {drill.contacts}, {drill.contacts_after} of them in the minute after the end "
        f"(plus {drill.contacts_adrift} by a vehicle adrift), "
        f"false alarms before the fault: {drill.false_alarms}; a minute after the end: "
        f"{sum(row.moving for row in drill.rows)} cases with a vehicle in motion, "
        f"{sum(row.air_on for row in drill.rows)} with bearing air on"
    )
    out.print(
        f"named: {sum(row.rightly for row in drill.rows)} of "
        f"{sum(row.judged for row in drill.rows)} answers have the right name"
    )
    for one in cases:
        if one.rightly is False:
            print_text(out, f"  {one.kind} was called {one.called}: {one.said}")
    for row in drill.rows:
        if row.alike:
            what = " or ".join(CATALOGUE[row.kind].alike)
            how = f"{row.kind} was called {what} ({row.alike})"
            print_text(out, f"  {how}: a vehicle cannot tell them apart")
    for one in cases:
        if one.missed or one.late or one.contacts or one.early:
            text = msgspec.json.encode(replace(one, again="")).decode()
            print_text(out, f"  {text}")
            if one.again:
                out.print(f"    {one.again}", markup=False, soft_wrap=True)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
