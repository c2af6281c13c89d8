"""`testbed bench`: fly the benchmark of record on the twin, or score what flew on a table."""

import shlex
import sys
from contextlib import redirect_stdout
from pathlib import Path

import msgspec
from rich.console import Console
from rich.table import Table as Grid

from testbed.campaign.benchmark import (
    COLUMNS,
    BenchmarkFile,
    Score,
    load_benchmark,
    page,
    scenario_campaign,
    score,
    scores,
)
from testbed.campaign.engine import workers
from testbed.campaign.evidence import read_run
from testbed.campaign.flight import Crew, fly_campaign
from testbed.campaign.sweep import experiment_path
from testbed.cli.campaign import TROUBLE, Bar, find_campaign, write_results
from testbed.cli.main import INTERRUPTED, OK
from testbed.cli.refusal import errors, refuse
from testbed.cli.run import Interrupt
from testbed.cli.trial import fly_batch, fly_with_log, read, warm
from testbed.config import SHIPPED, ConfigError
from testbed.ops.whole import write_whole

WIDEST = 500  # characters of a line


def run_benchmark(
    name: str | None, out: Path | None, jobs: int, scheduler: str | None, as_json: bool,
    samples: int | None, only: tuple[str, ...], runs: Path | None, commands: bool,
) -> int:  # fmt: skip
    """Fly or score, and return the exit code."""
    interrupt, table = Interrupt(), None
    try:
        path = find_campaign(name or str(SHIPPED / "benchmark.toml"))
        file = chosen(load_benchmark(path), only)
        if samples is not None:
            file = msgspec.structs.replace(file, samples=samples)
        folder = out or Path("runs") / f"benchmark_{file.name}"
        if commands:
            print_commands(path, file, runs or folder)
            return OK
        if runs is not None:
            table = score_folders(file, runs)
        else:
            with interrupt.caught(), interrupt.at_once(), redirect_stdout(sys.stderr):
                table = fly_benchmark(path, file, folder, jobs, scheduler)
        if table is None:
            errors.print(
                f"interrupted: what was flown is kept in {folder}; the same command goes on",
                style="yellow", markup=False, soft_wrap=True,
            )  # fmt: skip
            return INTERRUPTED
        text = msgspec.json.format(msgspec.json.encode(table), indent=2) + b"\n"
        if runs is None:
            write_whole(folder / "scores.json", text)
            options = "".join(f" --only {name}" for name in only)
            options += f" --samples {samples}" if samples else ""
            write_whole(folder / "benchmark.md", page(table, options, "twin").encode())
    except TROUBLE as error:
        return refuse(error)
    if as_json:
        sys.stdout.write(text.decode())
    else:
        print_scores(table)
    return OK


def chosen(file: BenchmarkFile, only: tuple[str, ...]) -> BenchmarkFile:
    """The benchmark with some of its scenarios."""
    for name in only:
        if name not in file.scenarios:
            raise ConfigError("--only", "", f"one of: {', '.join(file.scenarios)}", name)
    kept = {name: one for name, one in file.scenarios.items() if not only or name in only}
    return msgspec.structs.replace(file, scenarios=kept)


def fly_benchmark(
    path: Path, file: BenchmarkFile, folder: Path, jobs: int, scheduler: str | None
) -> list[Score]:
    """Fly every scenario on the twin."""
    campaigns = {name: scenario_campaign(path, file, name) for name in file.scenarios}
    table: list[Score] = []
    with workers(jobs, scheduler) as client:
        crew = Crew(fly_batch, fly_with_log, warm, read, jobs, scheduler, client)
        for name, campaign in campaigns.items():
            with Bar(name) as watch:
                text = path.read_bytes()
                ended = fly_campaign(campaign, text, folder / name, crew, watch)
            write_results(campaign, ended, folder / name)
            table += scores(campaign, name, ended.runs)
    return table


def score_folders(file: BenchmarkFile, runs: Path) -> list[Score]:
    """Score the run folders in `runs`/scenario/law/."""
    table = []
    for name, scenario in file.scenarios.items():
        for law in scenario.laws:
            place = runs / name / law
            folders = sorted(p for p in place.iterdir() if p.is_dir()) if place.is_dir() else []
            flown = [
                read_run(one, k, scenario.most, scenario.least) for k, one in enumerate(folders)
            ]
            if flown:
                table.append(score(name, law, flown))
    if not table:
        expected = "run folders in SCENARIO/LAW/: `testbed bench --commands` says how to make them"
        raise ConfigError(str(runs), "", expected, "none")
    return table


def print_commands(path: Path, file: BenchmarkFile, runs: Path) -> None:
    """Print the commands that fly the benchmark run by run, for instance on a table."""
    for name, scenario in file.scenarios.items():
        experiment = experiment_path(path, scenario.experiment)
        for law in scenario.laws:
            for k in range(file.samples):
                words = ["testbed", "run", str(experiment), *scenario.set, *file.laws[law]]
                place = runs / name / law / str(k)
                sys.stdout.write(
                    f"{shlex.join([*words, '--seed', str(file.seed + k), '--out', str(place)])}\n"
                )


def print_scores(table: list[Score]) -> None:
    """Print the table; no number is cut, in however narrow a window."""
    grid = Grid(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    for heading in ("scenario", "law"):
        grid.add_column(heading, no_wrap=True)
    headings = [heading.replace(" ", "\n").replace("[", "\\[") for heading, *_ in COLUMNS]
    for heading in ("passed", *headings, "robust"):
        grid.add_column(heading, justify="right")
    before = ""
    for row in table:
        cells = [row.scenario if row.scenario != before else "", row.law]
        cells.append(f"{row.passed}/{row.runs}")
        for _, key, scale, form in COLUMNS:
            value = getattr(row, key)
            cells.append("-" if value is None else form.format(scale * value))
        cells.append(f"{row.robust_passed}/{row.robust_runs}" if row.robust_runs else "-")
        grid.add_row(*cells, style="red" if row.passed < row.runs else None)
        before = row.scenario
    out = Console(highlight=False)
    out.width = max(out.width, out.measure(grid, options=out.options.update(width=WIDEST)).maximum)
    out.print(grid)
