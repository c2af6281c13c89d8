"""Flies a campaign file into its folder.

campaign.toml    copy of the campaign file
base.toml        the resolved experiment; a run is `testbed run base.toml` with key=value overrides
journal.jsonl    the result of every finished run (`journal.py`)
failures/        run folders of failed runs, at most `keep` of the file
results.parquet  all runs as one table; the same bytes on any number of workers
summary.json     what `--json` prints
report.html      the summary with figures
"""

import shlex
import shutil
import time
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct

from testbed.campaign.compilation import Read, Warm, compile_first
from testbed.campaign.engine import WorkerPool, count_workers, workers
from testbed.campaign.journal import Head, Journal, JournalError
from testbed.campaign.row import FlownRun, Kept, Task, within
from testbed.campaign.sweep import Campaign, CampaignFile, deciding, difference, read_file
from testbed.config import ConfigError, read_toml
from testbed.files import named, write_atomic
from testbed.run.code_digest import code_digest, digest_of

JOURNAL = "journal.jsonl"
UNLIKE = "unlike.txt"  # in a run's folder: columns that differed in the second flight
MOST_WARMED = 20  # combinations compiled in advance; workers compile the others


class RunFunctions(Struct, frozen=True):
    """Functions that fly runs, given by the caller; they run in a worker."""

    fly: Callable[[str, Sequence[Task]], list[FlownRun]]
    fly_with_log: Callable[[str, Sequence[Task]], list[Kept]]
    warm: Warm  # flies each for a moment, to compile the code
    read: Read  # makes the experiment of a task
    jobs: int = 1
    scheduler: str | None = None
    client: Any = None  # existing workers

    @contextmanager
    def workers(self, tasks: int) -> Iterator[Any]:
        """Workers for a number of tasks."""
        if self.client is not None:
            yield self.client
            return
        with workers(self.jobs, self.scheduler, tasks) as client:
            yield client


class CampaignObserver:
    """Observer of a campaign; this one does nothing."""

    def begun(self, total: int, runs: Sequence[FlownRun]) -> None:
        """The campaign begins: number of runs, and the runs flown before."""

    def flying(self, count_workers: Callable[[], int]) -> None:
        """The flights begin; `count_workers` may be called in any thread."""

    def flown(self, run: FlownRun) -> None:
        """Report a finished run."""

    def keeping(self, count: int) -> None:
        """`count` failures are flown again for their logs."""


class CampaignEnd(Struct, frozen=True):
    """Result of a campaign: its runs, where they are, what was lost."""

    runs: list[FlownRun]
    resumed: int  # number of runs flown by an earlier call
    wall_s: float  # wall time of the others
    unlike: list[int]  # runs whose second flight differed


def head_of(campaign: Campaign) -> Head:
    """The head of the campaign's journal."""
    return Head(digest_of(campaign.payload()), code_digest())


def make_folder(folder: Path) -> None:
    """Make the folder of a campaign or a tuning; it may exist and hold an unfinished one.

    Raises:
        JournalError: it cannot be made, or holds something else.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        found = "a file" if folder.is_file() else error.strerror
        raise JournalError(
            where=str(folder),
            expected="a writable folder; choose another with --out",
            found=str(found),
        ) from None
    if any(folder.iterdir()) and not (folder / JOURNAL).exists():
        raise JournalError(
            where=str(folder),
            expected=f"a new or empty folder, or an unfinished one with its {JOURNAL}",
            found="other files in it",
        )


def open_journal(campaign: Campaign, folder: Path) -> Journal[FlownRun]:
    """The journal in the campaign's folder."""
    make_folder(folder)
    words = partial(what_changed, campaign, folder)
    return Journal(folder / JOURNAL, head_of(campaign), FlownRun, words)


def what_changed(campaign: Campaign, folder: Path) -> str:
    """The first difference between a folder's campaign and this one, from its files."""
    with suppress(ConfigError):
        old = deciding(read_file(folder / "campaign.toml", CampaignFile))
        pairs = (
            (msgspec.to_builtins(old), msgspec.to_builtins(deciding(campaign.file)), ""),
            (read_toml(folder / "base.toml"), tomllib.loads(campaign.base), " of the experiment"),
        )
        for before, now, where in pairs:
            if words := difference(before, now):
                return words.replace("` was", f"`{where} was", 1)
        if campaign.files:
            return "a file that the grid names, at another place or with other content"
    return "another"


def flown_before(campaign: Campaign, found: Sequence[FlownRun]) -> dict[int, FlownRun]:
    """The valid runs of a journal by number; of duplicates, the later one.

    Leaves out runs beyond the last sample, if the file has fewer now, and runs lost to another
    `limit_s`.
    """
    limit_s = campaign.file.limit_s
    return {
        run.k: run
        for run in found
        if run.k < campaign.count and (run.outcome != "lost" or run.limit_s == limit_s)
    }


def fly_campaign(
    campaign: Campaign,
    text: bytes,
    folder: Path,
    fliers: RunFunctions,
    watch: CampaignObserver,
    finish: Callable[[CampaignEnd], object] = lambda ended: None,
) -> CampaignEnd:
    """Fly the runs that the journal does not have yet, and keep logs of failures.

    Args:
        campaign: the campaign to fly.
        text: content of its file.
        folder: the campaign's folder; it may hold an unfinished flight of the same campaign.
        crew: functions that fly.
        watch: observer of the progress.
        finish: writes the results, while the journal is locked.

    Raises:
        JournalError: the folder holds another campaign, or another process writes there.
        EngineError: there are no workers.
    """
    with open_journal(campaign, folder) as journal:
        write_atomic(folder / "campaign.toml", text)
        write_atomic(folder / "base.toml", campaign.base.encode())
        runs = flown_before(campaign, journal.found)
        resumed = len(runs)
        tasks = [
            (k, campaign.overrides(k)) for k in range(campaign.count) if k not in runs
        ]  # fmt: skip
        watch.begun(campaign.count, list(runs.values()))
        wall = 0.0
        if tasks or missing_folders(campaign, runs, folder):
            if fliers.scheduler is None:
                some = tasks[: min(MOST_WARMED, campaign.combinations)]
                compile_first(campaign.base, some, fliers.read, fliers.warm, campaign.file.limit_s)
            with fliers.workers(max(1, len(tasks))) as client:
                watch.flying(partial(count_workers, client))
                began = time.perf_counter()
                for flown in _fleet(client, campaign, fliers).results(tasks):
                    run = within(flown, campaign.file.most, campaign.file.least)
                    journal.append(run)
                    runs[run.k] = run
                    watch.flown(run)
                wall = time.perf_counter() - began
                keep_failures(client, campaign, runs, folder, fliers, watch)
        unlike = [
            k for k in kept_runs(campaign, runs) if (failure_folder(folder, k) / UNLIKE).exists()
        ]
        ended = CampaignEnd([runs[k] for k in sorted(runs)], resumed, wall, unlike)
        finish(ended)
    return ended


def _fleet(client: Any, campaign: Campaign, fliers: RunFunctions) -> WorkerPool[Task, FlownRun]:
    fly = partial(fliers.fly, campaign.base)
    limit_s = campaign.file.limit_s
    return WorkerPool(client, fly, partial(gone, limit_s), lambda run: run.wall_s, limit_s)


def gone(limit_s: float, task: Task) -> FlownRun:
    """The result of a run whose workers died."""
    words = f"its workers died while flying it, or it took longer than {limit_s:g} s (limit_s)"
    return FlownRun(task[0], "lost", words, limit_s=limit_s)


def failure_folder(folder: Path, k: int) -> Path:
    """Folder of run k if it failed."""
    return folder / "failures" / f"run_{k:06d}"


def kept_runs(campaign: Campaign, runs: dict[int, FlownRun]) -> list[int]:
    """Runs that get a folder: the first failed ones."""
    failed = [k for k in sorted(runs) if runs[k].outcome not in ("passed", "lost")]
    return failed[: campaign.file.keep]


def missing_folders(campaign: Campaign, runs: dict[int, FlownRun], folder: Path) -> list[int]:
    """Kept runs whose folder does not exist yet."""
    return [k for k in kept_runs(campaign, runs) if not failure_folder(folder, k).exists()]


def differences(first: FlownRun, again: Kept) -> list[str]:
    """Columns that differ between two flights of a run."""
    if bool(first.columns) != bool(again.columns):  # an exception ended one of them
        return ["how it ended"]
    known = {name: value for name, value in again.columns.items() if value is not None}
    return [name for name, value in known.items() if first.columns.get(name) != value]


def keep_failures(
    client: Any,
    campaign: Campaign,
    runs: dict[int, FlownRun],
    folder: Path,
    fliers: RunFunctions,
    watch: CampaignObserver,
) -> None:
    """Fly failures again, with a log."""
    missing = missing_folders(campaign, runs, folder)
    if not missing:
        return
    watch.keeping(len(missing))
    fleet: WorkerPool[Task, Kept] = WorkerPool(
        client,
        partial(fliers.fly_with_log, campaign.base),
        lambda task: Kept(task[0], {"error.txt": b"its workers died\n"}, {}),
        lambda kept: 1.0,
        campaign.file.limit_s,
    )
    for kept in fleet.results([(k, campaign.overrides(k)) for k in missing]):
        place = failure_folder(folder, kept.k)
        part = place.with_suffix(".part")
        shutil.rmtree(part, ignore_errors=True)  # left by an earlier call that was killed
        part.mkdir(parents=True)
        for name, data in kept.files.items():
            with named(part / name):
                (part / name).write_bytes(data)
        (part / "replay.txt").write_text(replay_command(campaign, folder, kept.k) + "\n")
        if otherwise := differences(runs[kept.k], kept):
            (part / UNLIKE).write_text(", ".join(otherwise) + "\n")
        part.replace(place)


def replay_command(campaign: Campaign, folder: Path, k: int) -> str:
    """The command that flies only run k."""
    words = ["testbed", "run", str(folder / "base.toml"), *campaign.overrides(k)]
    return shlex.join(words)
