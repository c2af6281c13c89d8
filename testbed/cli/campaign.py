"""`testbed campaign`: fly a sweep, store its runs and summarise them."""

import shlex
import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from pathlib import Path

import msgspec
from rich.console import Console
from rich.markup import escape
from rich.table import Table as Grid

from testbed.campaign.engine import EngineError, check_jobs
from testbed.campaign.flight import (
    CampaignEnd,
    RunFunctions,
    flown_before,
    fly_campaign,
    open_journal,
    replay_command,
)
from testbed.campaign.journal import JournalError
from testbed.campaign.report import html_report
from testbed.campaign.result import table_of, write_parquet
from testbed.campaign.row import FlownRun
from testbed.campaign.summary import Summary, summarise, worst_runs
from testbed.campaign.sweep import Campaign, load_campaign
from testbed.campaign.trial import fly_batch, fly_with_log, read, warm
from testbed.cli.exit_code import FAILED, INTERRUPTED, OK
from testbed.cli.progress import Bar
from testbed.cli.refusal import errors, refuse
from testbed.cli.screen import print_text, show
from testbed.config import ConfigError
from testbed.config.shipped import shipped
from testbed.config.tree import read_toml, trouble_at
from testbed.core.extra import MissingExtraError
from testbed.files import write_atomic
from testbed.run.interrupt import Interrupt

SHOWN = 10  # flights with a fault that the terminal lists
TROUBLE = (ConfigError, JournalError, EngineError, MissingExtraError, OSError)


def run_campaign(
    name: str, out: Path | None, jobs: int, scheduler: str | None, as_json: bool
) -> int:
    """Fly the campaign; return the exit code."""
    interrupt, ended, watch = Interrupt(), None, Bar()
    summaries: list[Summary] = []
    try:
        check_jobs(jobs, scheduler)
        path = find_campaign(name)
        check_verb(path, tunes=False)
        with redirect_stdout(sys.stderr):  # keeps a law's prints out of the result
            campaign = load_campaign(path)
        folder = out or Path("runs") / f"campaign_{campaign.file.name}"
        fliers = RunFunctions(fly_batch, fly_with_log, warm, read, jobs, scheduler)
        with interrupt.caught(), interrupt.at_once(), watch, redirect_stdout(sys.stderr):
            ended = fly_campaign(
                campaign, path.read_bytes(), folder, fliers, watch,
                lambda ended: summaries.append(write_results(campaign, ended, folder)),
            )  # fmt: skip
        if ended is None:
            say_interrupted(campaign, folder)
            return INTERRUPTED
    except TROUBLE as error:
        return refuse(error)
    (summary,) = summaries
    if as_json:
        sys.stdout.write(json_of(summary).decode())
    else:
        print_summary(summary, campaign, ended.runs, folder)
    wanted = campaign.file.success
    return OK if wanted is None or summary.confidence_interval[0] >= wanted else FAILED


def find_campaign(name: str) -> Path:
    """The path of a campaign file that exists."""
    path = Path(name)
    if trouble := trouble_at(path):
        hint = ""
        if name in shipped("experiments"):
            hint = f'{name} is an experiment; a campaign file has `experiment = "{name}"`'
        elif known := shipped("campaigns").get(path.stem):
            hint = f"the shipped file is {known}"
        raise ConfigError(name, "", "a campaign file", trouble, hint)
    return path


def check_verb(path: Path, *, tunes: bool) -> None:
    """Refuse a campaign's file for a tuning, or a tuning's for a campaign."""
    found = read_toml(path)
    if tunes and {"grid", "draw"} & found.keys():
        hint = f"testbed campaign {shlex.quote(str(path))}"
        raise ConfigError(str(path), "", "a tuning file", "a campaign file", hint)
    if not tunes and "gain" in found:
        hint = f"testbed tune {shlex.quote(str(path))}"
        raise ConfigError(str(path), "", "a campaign file", "a tuning file", hint)


def say_interrupted(campaign: Campaign, folder: Path) -> None:
    """Print how many runs are finished."""
    with open_journal(campaign, folder) as journal:
        count = len(flown_before(campaign, journal.found))
    print_text(
        errors,
        f"interrupted: {count} of {campaign.count} runs are kept in {folder}; "
        "the same command resumes there",
        "yellow",
    )


def write_results(campaign: Campaign, ended: CampaignEnd, folder: Path) -> Summary:
    """Write Parquet, summary and report. The caller holds the journal, so no two write at once."""
    summary = summarise(campaign, experiment_name(campaign), ended)
    table = table_of(campaign, ended.runs)
    facts = {"campaign": campaign.file.name, "description": campaign.file.description}
    write_parquet(folder / "results.parquet", table, facts)
    write_atomic(folder / "summary.json", json_of(summary))
    page = html_report(campaign, summary, ended.runs, table, folder)
    write_atomic(folder / "report.html", page.encode())
    return summary


def json_of(summary: Summary) -> bytes:
    """Content of summary.json, and what `--json` prints."""
    return msgspec.json.format(msgspec.json.encode(summary), indent=2) + b"\n"


def experiment_name(campaign: Campaign) -> str:
    """Name of the base experiment."""
    return Path(campaign.file.experiment).stem


def print_summary(
    summary: Summary, campaign: Campaign, runs: Sequence[FlownRun], folder: Path
) -> None:
    """Print the success rate, the faults, the spreads and the worst runs."""
    out = Console(highlight=False)
    low, high = summary.confidence_interval
    title = f"[bold]{summary.campaign}[/]: {summary.runs} runs of {escape(summary.experiment)}"
    rate = 100.0 * (summary.success_rate or 0.0)
    out.print(
        f"{title}, {summary.succeeded} passed: [bold]{rate:.1f} %[/] "
        f"({100 * low:.1f} to {100 * high:.1f} % with {100 * summary.confidence:g} % confidence)",
        soft_wrap=True,
    )
    for reason, count in summary.reasons.items():
        out.print(f"  {count:5d}  {reason}", markup=False, style="red")
    faulty = [run for run in runs if run.outcome == "fault"]
    for words, run in zip(summary.faults[:SHOWN], faulty, strict=False):
        print_text(out, f"  {words}", "red")
        command = replay_command(campaign, folder, run.k)
        out.print(f"    {command}", markup=False, soft_wrap=True)
    if (more := summary.outcomes.get("fault", 0) - SHOWN) > 0:
        out.print(f"  ... and {more} more in summary.json and results.parquet", style="red")
    _print_spreads(out, summary)
    _print_cases(out, summary)
    if summary.spreads:
        out.print("\nworst", style="bold")
        for run in worst_runs(runs, summary.spreads[0].quantity, 3):
            out.print(f"  run {run.k} {run.outcome}", markup=False)
            command = replay_command(campaign, folder, run.k)
            out.print(f"    {command}", markup=False, soft_wrap=True)
    if summary.runs_per_second:
        out.print(
            f"\n{summary.runs - summary.resumed} runs in {summary.wall_s:.1f} s, "
            f"{summary.runs_per_second:.2f} per second; "
            f"at most {summary.worker_memory_mb:.0f} MB per worker"
        )
    if summary.not_repeatable:
        out.print(
            f"NOT REPEATABLE: another flight gave another result: runs {summary.not_repeatable}",
            style="bold red",
        )
    out.print(f"report: {folder / 'report.html'}", markup=False, soft_wrap=True)


def _print_spreads(out: Console, summary: Summary) -> None:
    grid = Grid(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for heading in ("", "runs", "best", "median", "95 %", "worst", "in run"):
        grid.add_column(heading, justify="right" if heading else "left")
    for one in summary.spreads:
        unit = f" \\[{one.quantity.unit}]" if one.quantity.unit else ""
        numbers = (one.best, one.median, one.p95, one.worst)
        grid.add_row(
            one.quantity.title + unit, str(one.runs), *(f"{number:.4g}" for number in numbers),
            str(one.worst_run),
        )  # fmt: skip
    show(out, grid)


def _print_cases(out: Console, summary: Summary) -> None:
    if not summary.cases:
        return
    grid = Grid(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for name in summary.cases[0].name:
        grid.add_column(escape(name))
    for heading in ("passed", "rate", "interval"):
        grid.add_column(heading, justify="right")
    for case in summary.cases[:40]:
        rate = case.rate
        grid.add_row(
            *map(escape, case.name.values()),
            f"{rate.succeeded}/{rate.runs}", f"{100 * (rate.rate or 0):.1f} %",
            f"{100 * rate.low:.1f} to {100 * rate.high:.1f} %",
        )  # fmt: skip
    out.print("")
    show(out, grid)
    if len(summary.cases) > 40:
        out.print(f"... and {len(summary.cases) - 40} more in the report")
