"""A campaign from its file to its folder.

campaign.toml    the file as it was
base.toml        the resolved experiment; a run is `testbed run base.toml` with some key=value
journal.jsonl    every run that is over, as it ended (`journal.py`)
failures/        run folders of runs that did not pass, as many as the file wants to keep
results.parquet  all runs as one table; the same bytes whoever flew them
summary.json     what `--json` prints
report.html      the same to look at
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

from testbed.campaign.code import code_digest, digest_of
from testbed.campaign.compilation import Read, Warm, compile_first
from testbed.campaign.engine import Fleet, count_workers, workers
from testbed.campaign.journal import Head, Journal, JournalError
from testbed.campaign.row import Flown, Kept, Task, within
from testbed.campaign.sweep import Campaign, CampaignFile, deciding, difference, read_file
from testbed.config import ConfigError, read_toml
from testbed.files import named, write_atomic

UNLIKE = "unlike.txt"  # in a run's folder: what was not the same the second time
MOST_WARMED = 20  # combinations of a grid; others are compiled by their worker


class Fliers(Struct, frozen=True):
    """How runs are flown, handed in from above: both run in a worker."""

    fly: Callable[[str, Sequence[Task]], list[Flown]]
    fly_with_log: Callable[[str, Sequence[Task]], list[Kept]]
    warm: Warm  # a moment of each, so that all is compiled
    read: Read  # what a task flies
    jobs: int = 1
    scheduler: str | None = None
    client: Any = None  # workers that are there already

    @contextmanager
    def workers(self, tasks: int) -> Iterator[Any]:
        """Those who fly so many tasks."""
        if self.client is not None:
            yield self.client
            return
        with workers(min(self.jobs, tasks), self.scheduler) as client:
            yield client


class CampaignObserver:
    """Whoever watches a campaign; this one does not."""

    def begun(self, total: int, runs: Sequence[Flown]) -> None:
        """So many runs there are, and these were flown before."""

    def flying(self, count_workers: Callable[[], int]) -> None:
        """All is compiled; this asks how many workers there are, in any thread."""

    def flown(self, run: Flown) -> None:
        """One more is over."""

    def keeping(self, count: int) -> None:
        """So many are flown once more for their logs."""


class Ended(Struct, frozen=True):
    """A campaign that is through."""

    runs: list[Flown]
    resumed: int  # of these, flown by an earlier call
    wall_s: float  # of flying the others
    unlike: list[int]  # runs that were not the same the second time


def head_of(campaign: Campaign) -> Head:
    """What its journal belongs to."""
    return Head(digest_of(campaign.payload()), code_digest())


def make_folder(folder: Path) -> None:
    """Of a campaign or a tuning; it may be there.

    Raises:
        JournalError: it cannot be.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        found = "a file" if folder.is_file() else error.strerror
        raise JournalError(
            f"{folder}\n  expected  a folder that can be written; --out names another\n"
            f"  found     {found}"
        ) from None


def open_journal(campaign: Campaign, folder: Path) -> Journal[Flown]:
    """The campaign's journal in its folder."""
    make_folder(folder)
    words = partial(what_changed, campaign, folder)
    return Journal(folder / "journal.jsonl", head_of(campaign), Flown, words)


def what_changed(campaign: Campaign, folder: Path) -> str:
    """What a folder's campaign had otherwise, as far as its files say."""
    with suppress(ConfigError):
        old = deciding(read_file(folder / "campaign.toml", CampaignFile))
        pairs = (
            (msgspec.to_builtins(old), msgspec.to_builtins(deciding(campaign.file)), ""),
            (read_toml(folder / "base.toml"), tomllib.loads(campaign.base), " of the experiment"),
        )
        for before, now, where in pairs:
            if words := difference(before, now):
                return words.replace("` was", f"`{where} was", 1)
    return "another"


def flown_before(campaign: Campaign, found: Sequence[Flown]) -> dict[int, Flown]:
    """The runs of a journal that count, by number; of one that is there twice, the later.

    Not those behind the last sample, if the file has fewer now; nor what was lost to another limit.
    """
    limit_s = campaign.file.limit_s
    return {
        run.k: run
        for run in found
        if run.k < campaign.count and (run.outcome != "lost" or run == gone(limit_s, (run.k, ())))
    }


def fly_campaign(
    campaign: Campaign,
    text: bytes,
    folder: Path,
    fliers: Fliers,
    watch: CampaignObserver,
    finish: Callable[[Ended], object] = lambda ended: None,
) -> Ended:
    """Fly what the journal does not have yet, and keep what failed.

    Args:
        campaign: to fly.
        text: of its file.
        folder: of the campaign; it may hold the beginning of the same one.
        fliers: who flies.
        watch: who is told.
        finish: writes the results, while nobody else may write there.

    Raises:
        JournalError: the folder holds something else, or somebody else writes there.
        EngineError: nobody is there to fly.
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
        ended = Ended([runs[k] for k in sorted(runs)], resumed, wall, unlike)
        finish(ended)
    return ended


def _fleet(client: Any, campaign: Campaign, fliers: Fliers) -> Fleet[Task, Flown]:
    fly = partial(fliers.fly, campaign.base)
    limit_s = campaign.file.limit_s
    return Fleet(client, fly, partial(gone, limit_s), lambda run: run.wall_s, limit_s)


def gone(limit_s: float, task: Task) -> Flown:
    """A run that took its workers with it."""
    words = f"its workers died while flying it, or it took longer than {limit_s:g} s (limit_s)"
    return Flown(task[0], "lost", words)


def failure_folder(folder: Path, k: int) -> Path:
    """Where run k is kept when it did not pass."""
    return folder / "failures" / f"run_{k:06d}"


def kept_runs(campaign: Campaign, runs: dict[int, Flown]) -> list[int]:
    """Runs that have a folder in the end: the first ones that did not pass."""
    failed = [k for k in sorted(runs) if runs[k].outcome not in ("passed", "lost")]
    return failed[: campaign.file.keep]


def missing_folders(campaign: Campaign, runs: dict[int, Flown], folder: Path) -> list[int]:
    """Those of them whose folder is still to be made."""
    return [k for k in kept_runs(campaign, runs) if not failure_folder(folder, k).exists()]


def differences(first: Flown, again: Kept) -> list[str]:
    """What a run did otherwise the second time."""
    if bool(first.columns) != bool(again.columns):  # one of them was ended by an exception
        return ["how it ended"]
    known = {name: value for name, value in again.columns.items() if value is not None}
    return [name for name, value in known.items() if first.columns.get(name) != value]


def keep_failures(
    client: Any,
    campaign: Campaign,
    runs: dict[int, Flown],
    folder: Path,
    fliers: Fliers,
    watch: CampaignObserver,
) -> None:
    """Fly failures once more, with a log."""
    missing = missing_folders(campaign, runs, folder)
    if not missing:
        return
    watch.keeping(len(missing))
    fleet: Fleet[Task, Kept] = Fleet(
        client,
        partial(fliers.fly_with_log, campaign.base),
        lambda task: Kept(task[0], {"error.txt": b"its workers died\n"}, {}),
        lambda kept: 1.0,
        campaign.file.limit_s,
    )
    for kept in fleet.results([(k, campaign.overrides(k)) for k in missing]):
        place = failure_folder(folder, kept.k)
        part = place.with_suffix(".part")
        shutil.rmtree(part, ignore_errors=True)  # of an earlier call that was killed
        part.mkdir(parents=True)
        for name, data in kept.files.items():
            with named(part / name):
                (part / name).write_bytes(data)
        (part / "replay.txt").write_text(replay_command(campaign, folder, kept.k) + "\n")
        if otherwise := differences(runs[kept.k], kept):
            (part / UNLIKE).write_text(", ".join(otherwise) + "\n")
        part.replace(place)


def replay_command(campaign: Campaign, folder: Path, k: int) -> str:
    """The command that flies run k alone."""
    words = ["testbed", "run", str(folder / "base.toml"), *campaign.overrides(k)]
    return shlex.join(words)
