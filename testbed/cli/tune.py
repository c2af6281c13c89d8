"""`testbed tune`: optimise gains in flights, and write the best as an experiment."""

import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import redirect_stdout
from functools import partial
from pathlib import Path

import msgspec
import tomli_w
from msgspec import Struct
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table as Grid

from testbed.campaign.compilation import compile_first
from testbed.campaign.engine import WorkerPool, check_jobs, workers
from testbed.campaign.flight import JOURNAL, gone, make_folder
from testbed.campaign.journal import Head, Journal
from testbed.campaign.row import FlownRun, Task
from testbed.campaign.trial import fly_batch, read, warm
from testbed.campaign.tuning import (
    PROOF_SEEDS,
    OptunaOptimiser,
    Trial,
    Tuning,
    best_of,
    judged,
    load_tuning,
    tune,
)
from testbed.cli.campaign import TROUBLE, check_verb, find_campaign
from testbed.cli.exit_code import FAILED, INTERRUPTED, OK
from testbed.cli.refusal import errors, refuse
from testbed.cli.screen import print_text, show
from testbed.config import dump, load
from testbed.files import write_atomic
from testbed.run.code_digest import code_digest, digest_of
from testbed.run.interrupt import Interrupt


class TuningResult(Struct, frozen=True):
    """Content of tuning.json, and what `--json` prints."""

    tuning: str
    trials: int
    within_bounds: int
    best: Trial | None
    start: Trial
    proof_seeds: int
    start_proof: float | None  # mean cost over seeds that the tuning did not use
    start_proof_broken: int
    best_proof: float | None
    best_proof_broken: int
    gains: dict[str, float]
    best_proof_reasons: list[str] = []  # reasons why runs of the best gains broke a bound


def run_tuning(name: str, out: Path | None, jobs: int, scheduler: str | None, as_json: bool) -> int:
    """Tune; return the exit code."""
    interrupt, result = Interrupt(), None
    try:
        check_jobs(jobs, scheduler)
        path = find_campaign(name)
        check_verb(path, tunes=True)
        with redirect_stdout(sys.stderr):  # keeps a law's prints out of the result
            tuning = load_tuning(path)
        folder = out or Path("runs") / f"tuning_{tuning.file.name}"
        make_folder(folder)
        with interrupt.caught(), interrupt.at_once(), redirect_stdout(sys.stderr):
            result = fly_tuning(tuning, folder, jobs, scheduler)
        if result is None:
            print_text(
                errors,
                f"interrupted: finished trials are kept in {folder}; the same command resumes",
                "yellow",
            )
            return INTERRUPTED
        text = msgspec.json.format(msgspec.json.encode(result), indent=2) + b"\n"
        write_atomic(folder / "tuning.json", text)
        if result.best is not None:
            write_experiment(tuning, result.best, folder)
    except TROUBLE as error:
        return refuse(error)
    if as_json:
        sys.stdout.write(text.decode())
    else:
        print_result(tuning, result, folder)
    return OK if result.best is not None and result.best_proof_broken == 0 else FAILED


def fly_tuning(tuning: Tuning, folder: Path, jobs: int, scheduler: str | None) -> TuningResult:
    """Fly all trials, then compare the best with the start on other seeds."""
    head = Head(digest_of(tuning.payload()), code_digest())
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(),
    )  # fmt: skip
    progress = Progress(*columns, console=errors, transient=True, disable=not errors.is_terminal)
    optimiser = OptunaOptimiser(tuning)
    with Journal(folder / JOURNAL, head, Trial) as journal, progress:
        write_atomic(folder / "base.toml", tuning.base.encode())
        bar = progress.add_task("getting ready", total=tuning.file.trials)
        progress.update(bar, completed=len(journal.found))
        best = [trial.cost for trial in journal.found]
        first = tuning.tasks(0, tuning.now, [tuning.file.seed])
        if scheduler is None:
            compile_first(tuning.base, first, read, warm, tuning.file.limit_s)
        with workers(jobs, scheduler) as client:

            def fly(tasks: Sequence[Task]) -> Iterator[FlownRun]:
                return _fleet(client, tuning).results(tasks)

            def done(trial: Trial) -> None:
                journal.append(trial)
                best.append(trial.cost)
                progress.update(bar, advance=1, description=f"best {min(best):.4g}")

            trials = tune(tuning, optimiser, journal.found, fly, done)
            progress.update(bar, description="comparing on other seeds")
            return compare(tuning, trials, fly)


def _fleet(client: object, tuning: Tuning) -> WorkerPool[Task, FlownRun]:
    fly = partial(fly_batch, tuning.base)
    limit_s = tuning.file.limit_s
    return WorkerPool(client, fly, partial(gone, limit_s), lambda run: run.wall_s, limit_s)


def compare(
    tuning: Tuning, trials: Sequence[Trial], fly: Callable[[Sequence[Task]], Iterable[FlownRun]]
) -> TuningResult:
    """Compare the best gains with the original ones, on seeds that the tuning did not use."""
    best, file = best_of(trials), tuning.file
    seeds = range(file.seed + PROOF_SEEDS, file.seed + PROOF_SEEDS + file.proof)
    proof: list[Trial] = []
    if best is not None and file.proof:
        for trial in (trials[0], best):
            runs = list(fly(tuning.tasks(0, trial.gains, seeds)))
            proof.append(judged(tuning, trial.number, trial.gains, runs))
    return TuningResult(
        tuning=file.name,
        trials=len(trials),
        within_bounds=sum(trial.broken == 0 for trial in trials),
        best=best,
        start=trials[0],
        proof_seeds=len(seeds),
        start_proof=proof[0].cost if proof else None,
        start_proof_broken=proof[0].broken if proof else 0,
        best_proof=proof[1].cost if proof else None,
        best_proof_broken=proof[1].broken if proof else 0,
        gains=dict(zip([g.key for g in file.gain], best.gains, strict=True)) if best else {},
        best_proof_reasons=proof[1].reasons if proof else [],
    )


def write_experiment(tuning: Tuning, best: Trial, folder: Path) -> None:
    """Write the experiment with the best gains as one complete file."""
    experiment = load(folder / "base.toml", tuning.overrides(best.gains))
    head = f"# Tuned by `testbed tune`: trial {best.number}, cost {best.cost:g}.\n\n"
    write_atomic(folder / "tuned.toml", (head + tomli_w.dumps(dump(experiment))).encode())


def print_result(tuning: Tuning, result: TuningResult, folder: Path) -> None:
    """Print gains and costs before and after."""
    out = Console(highlight=False)
    kept = f"{result.within_bounds} of {result.trials} trials within the bounds"
    if result.best is None:
        first = escape((result.start.reasons or [result.start.reason])[0])
        out.print(f"[bold red]no safe gains found[/]: {kept}; the first trial: {first}")
        return
    grid = Grid(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for heading in ("", "original", "tuned", "range"):
        grid.add_column(heading, justify="right" if heading else "left")
    for gain, old, new in zip(tuning.file.gain, result.start.gains, result.best.gains, strict=True):
        grid.add_row(escape(gain.key), f"{old:.4g}", f"{new:.4g}", f"{gain.low:g} to {gain.high:g}")
    before, after = result.start, result.best
    costs = _cost(before.cost, before.broken), _cost(after.cost, after.broken)
    grid.add_row("cost, tuning seeds", *costs, "")
    if result.start_proof is not None and result.best_proof is not None:
        words = f"cost, {result.proof_seeds} other seeds"
        costs = (
            _cost(result.start_proof, result.start_proof_broken),
            _cost(result.best_proof, result.best_proof_broken),
        )
        grid.add_row(words, *costs, "")
    out.print(f"[bold]{result.tuning}[/]: {kept}, the best is trial {result.best.number}")
    show(out, grid)
    if result.best_proof_broken:
        out.print(
            f"[bold red]not safe on {result.best_proof_broken} of the other seeds[/];"
            " increase `samples`"
        )
        for words in result.best_proof_reasons:
            print_text(out, f"  {words}", "red")
        tuned = shlex.quote(str(folder / "tuned.toml"))
        out.print(f"  see one: testbed run {tuned} --seed SEED", markup=False, soft_wrap=True)
    elif result.best_proof is not None and result.best_proof >= (result.start_proof or 0.0):
        words = "no better than the original on other seeds: it fits its own; increase `samples`"
        out.print(words, style="bold yellow")
    out.print(f"tuned experiment: {folder / 'tuned.toml'}", markup=False, soft_wrap=True)


def _cost(cost: float, broken: int) -> str:
    return "not safe" if broken else f"{cost:.4g}"
