"""`testbed benchmark`: fly the benchmark of record on the twin, or score runs of a table."""

import shlex
import sys
import textwrap
from contextlib import redirect_stdout, suppress
from functools import partial
from pathlib import Path

import msgspec
from rich.console import Console
from rich.markup import escape
from rich.table import Table as Grid

from testbed.campaign.anchor import anchored
from testbed.campaign.benchmark import (
    BenchmarkFile,
    Record,
    Score,
    load_benchmark,
    scenario_campaign,
    scores,
)
from testbed.campaign.engine import workers
from testbed.campaign.flight import JOURNAL, RunFunctions, fly_campaign
from testbed.campaign.folders import score_folders
from testbed.campaign.page import COLUMNS, cells_of, page, reasons_of
from testbed.campaign.sweep import experiment_path
from testbed.campaign.trial import fly_batch, fly_with_log, read, warm
from testbed.cli.campaign import TROUBLE, Bar, find_campaign, write_results
from testbed.cli.exit_code import INTERRUPTED, OK
from testbed.cli.refusal import errors, refuse
from testbed.cli.screen import print_text, show
from testbed.config import SHIPPED, ConfigError, find
from testbed.files import write_atomic
from testbed.run.code_digest import code_digest, own_version
from testbed.run.interrupt import Interrupt

BEFORE = (  # comment above the commands
    "One command per run, for any rig; on a table append `--rig table` to each. Run them one by "
    "one and return the vehicles to their starts in between, so do not run them as a script.",
    "For your own table and vehicle, insert before the first KEY=VALUE of each command: "
    "table=lab/table.toml 'vehicles.*.model=lab/sat1.toml' (or vehicles.sat1.model=... for each). "
    "Keep the law's gains.",
    "To resume after a fault or a refill, run the commands whose folders do not exist yet; an "
    "existing folder is refused and never overwritten. A run that a fault ended counts: keep it, "
    "inspect the vehicles, and append `--reset` to the next command. If a run never armed, or was "
    "stopped for a reason other than the law, remove its folder, repeat its command, and report "
    "that with the results.",
    "Afterwards: testbed benchmark --from {runs}",
)


def run_benchmark(
    name: str | None, out: Path | None, jobs: int, scheduler: str | None, as_json: bool,
    samples: int | None, only: tuple[str, ...], runs: Path | None, commands: bool,
) -> int:  # fmt: skip
    """Fly or score; return the exit code."""
    interrupt, table = Interrupt(), None
    try:
        path = find_campaign(name or str(SHIPPED / "benchmark.toml"))
        whole = load_benchmark(path)
        file = chosen(whole, only)
        if samples is not None:
            file = msgspec.structs.replace(file, samples=samples)
        options = "".join(f" --only {name}" for name in only)
        options += f" --samples {samples}" if samples else ""
        folder = out or Path("runs") / f"benchmark_{file.name}"
        if commands:
            print_commands(path, file, runs or out or Path("runs") / f"benchmark_{file.name}_table")
            return OK
        if runs is not None:
            folder = out or runs
            not_the_twins(folder, file)
            record = score_folders(path, whole, file, runs)
            options = f" --from FOLDER{options}"
        else:
            with interrupt.caught(), interrupt.at_once(), redirect_stdout(sys.stderr):
                table = fly_benchmark(path, file, folder, jobs, scheduler)
            if table is None:
                print_text(
                    errors,
                    f"interrupted: finished runs are kept in {folder}; the same command resumes",
                    "yellow",
                )
                return INTERRUPTED
            record = Record(file.name, own_version(), table, code_digest())
        text = msgspec.json.format(msgspec.json.encode(record), indent=2) + b"\n"
        folder.mkdir(parents=True, exist_ok=True)
        write_atomic(folder / "scores.json", text)
        write_atomic(folder / "benchmark.md", page(record, path, file, options).encode())
    except TROUBLE as error:
        return refuse(error)
    if as_json:
        sys.stdout.write(text.decode())
    else:
        print_scores(record.scores)
    print_concerns(record)
    return OK


def chosen(file: BenchmarkFile, only: tuple[str, ...]) -> BenchmarkFile:
    """The benchmark, reduced to the scenarios of `--only`."""
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
        fliers = RunFunctions(fly_batch, fly_with_log, warm, read, jobs, scheduler, client)
        for name, campaign in campaigns.items():
            finish = partial(write_results, campaign, folder=folder / name)
            with Bar(name) as watch:
                ended = fly_campaign(
                    campaign, path.read_bytes(), folder / name, fliers, watch, finish
                )
            table += scores(campaign, name, ended.runs)
    return table


def not_the_twins(folder: Path, file: BenchmarkFile) -> None:
    """Refuse to write a lab's scores over the twin's."""
    for name in file.scenarios:
        if (folder / name / JOURNAL).exists():
            expected = "--out with another folder: this one holds the twin's benchmark"
            raise ConfigError(str(folder), "", expected, f"{name}/{JOURNAL}")


def print_commands(path: Path, file: BenchmarkFile, runs: Path) -> None:
    """Print the commands that fly the benchmark run by run, for instance on a table."""
    where = shlex.quote(str(runs))
    lines = [line for text in BEFORE for line in comment(text.format(runs=where))]
    if file.trouble:
        how = file.trouble_hardware or "the benchmark's file does not say how"
        lines += comment(f"The robustness runs (`robust`) are not among these: {how}")
    for name, scenario in file.scenarios.items():
        lines += ["", f"# {name}"]
        if scenario.hardware:
            lines += comment(f"On a table: {scenario.hardware}")
        experiment = shown_experiment(experiment_path(path, scenario.experiment))
        for law in scenario.laws:
            for k in range(file.samples):
                texts = [*scenario.set, *file.laws[law]]
                placed = [anchored(text, path.parent) for text in texts]
                words = ["testbed", "run", experiment, *placed]
                place = runs / name / law / str(k)
                words += ["--seed", str(file.seed + k), "--out", str(place)]
                lines.append(shlex.join(words))
    sys.stdout.write("\n".join(lines) + "\n")


def shown_experiment(path: Path) -> str:
    """The shortest way to type an experiment: its name, or its path relative to here."""
    whole, here, shelf = path.resolve(), Path.cwd(), SHIPPED.resolve()
    names = [whole.stem]
    if whole.is_relative_to(shelf):
        names.append(whole.relative_to(shelf).with_suffix("").as_posix())
    for name in names:
        with suppress(ConfigError):  # no shipped experiment has this name
            if find(name).resolve() == whole:
                return name
    return str(whole.relative_to(here) if whole.is_relative_to(here) else path)


def comment(text: str) -> list[str]:
    """The text as wrapped shell comments."""
    return textwrap.wrap(
        text, 98, initial_indent="# ", subsequent_indent="#   ", break_on_hyphens=False,
        break_long_words=False,
    )  # fmt: skip


def print_concerns(record: Record) -> None:
    """Print on standard error which runs are skipped, missing or different."""
    lines = [f"skipped: {one.folder}: {one.reason}" for one in record.passed_over]
    lines += [f"not flown: {one}" for one in record.not_flown]
    lines += [f"differs from the benchmark: {one}" for one in record.own]
    for line in lines:
        print_text(errors, line, "yellow")


def print_scores(table: list[Score]) -> None:
    """Print the table."""
    grid = Grid(box=None, pad_edge=False, padding=(0, 1, 0, 0))
    for heading in ("scenario", "law"):
        grid.add_column(heading)
    headings = [heading.replace(" ", "\n").replace("[", "\\[") for heading, *_ in COLUMNS]
    rigs = any(row.rig != "twin" for row in table)
    for heading in ("passed", *headings, "robust", *["rig"] * rigs):
        grid.add_column(heading, justify="right")
    for row, cells in zip(table, cells_of(table), strict=True):
        grid.add_row(*cells, style="red" if row.passed < row.runs else None)
    out = Console(highlight=False)
    show(out, grid)
    why = list(reasons_of(table))
    if why:
        lines = Grid("not passed", "reason (runs)", box=None, pad_edge=False, padding=(0, 2, 0, 0))
        for name, reason in why:
            lines.add_row(escape(name), escape(reason))
        out.print()
        show(out, lines)
