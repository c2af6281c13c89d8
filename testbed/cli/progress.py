"""Progress of a campaign: a bar at a terminal, one line per minute without a terminal.

Batch systems and CI have no terminal. The lines go to standard error, also with `--json`, because
standard output is for the result.
"""

import time
from collections.abc import Callable, Sequence
from datetime import timedelta
from threading import Event, Thread

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from testbed.campaign.flight import CampaignObserver
from testbed.campaign.row import FlownRun
from testbed.cli.live import CALM
from testbed.cli.refusal import errors
from testbed.cli.tracked import LINE_S

BAR = 12  # columns: with times and counts a line fits a terminal of 80
LOOK_S = 5.0  # interval of counting workers, at a terminal [s]
NO_WORKERS = "no workers yet; waiting"


class Bar(CampaignObserver):
    """Progress of a campaign; a context manager."""

    def __init__(self, name: str = "", line_s: float = LINE_S) -> None:
        self._name = name
        self._progress = Progress(
            TextColumn("{task.description}"), BarColumn(BAR, complete_style=CALM),
            MofNCompleteColumn(),
            TaskProgressColumn(), TextColumn("after"), TimeElapsedColumn(),
            TextColumn("left"), TimeRemainingColumn(),
            console=errors, transient=True, disable=not errors.is_terminal,
            refresh_per_second=2,  # ten, the default, take 2 % of a core
        )  # fmt: skip
        self._words = "getting ready (compiles on the first run)"
        self._total = self._passed = self._over = self._here = 0
        self._began = 0.0  # end of the first run of this call [s]
        self._count_workers: Callable[[], int] | None = None
        self._every_s = LOOK_S if errors.is_terminal else line_s
        self._end = Event()
        self._printer = Thread(target=self._print_lines, daemon=True)

    def __enter__(self) -> "Bar":
        self._progress.start()
        self._bar = self._progress.add_task(f"{self._name} getting ready", total=None)
        self._printer.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._printer.join(1.0)  # a lost cluster may block the thread
        self._progress.stop()

    def begun(self, total: int, runs: Sequence[FlownRun]) -> None:
        """See `CampaignObserver`."""
        self._total, self._over = total, len(runs)
        self._passed = sum(run.outcome == "passed" for run in runs)
        self._progress.update(self._bar, total=total, completed=self._over)

    def flying(self, count_workers: Callable[[], int]) -> None:
        """See `CampaignObserver`."""
        self._count_workers = count_workers
        self._print("flying")

    def flown(self, run: FlownRun) -> None:
        """See `CampaignObserver`."""
        self._over += 1
        self._here += 1
        if self._here == 1:
            self._began = time.monotonic()
        self._passed += run.outcome == "passed"
        self._progress.update(self._bar, completed=self._over)
        self._print(f"passed {100.0 * self._passed / self._over:.1f} %")

    def keeping(self, count: int) -> None:
        """See `CampaignObserver`."""
        self._print(f"logs of {count} failures")

    def _print(self, words: str) -> None:
        self._words = words
        self._progress.update(self._bar, description=f"{self._name} {words}")

    def _print_lines(self) -> None:
        """Thread that prints progress, because the main thread waits for the workers."""
        while not self._end.wait(self._every_s):
            no_workers = self._has_no_workers()
            if self._end.is_set():
                return
            if not errors.is_terminal:
                words = self.line(time.monotonic(), no_workers)
                errors.print(words, markup=False, soft_wrap=True)
            elif no_workers:
                self._progress.update(self._bar, description=f"{self._name} {NO_WORKERS}")

    def _has_no_workers(self) -> bool:
        try:
            return self._count_workers is not None and self._count_workers() == 0
        # Dask raises errors of many classes for a lost cluster, which the main thread reports;
        # an exception here would only end the progress line.
        except Exception:
            return False

    def line(self, now: float, no_workers: bool) -> str:
        """The progress line at time `now` [s]; `no_workers`: the cluster has none."""
        parts = [f"{self._name} {self._over} of {self._total} runs".strip()] if self._total else []
        parts.append(NO_WORKERS if no_workers else self._words)
        if self._here > 1 and now > self._began:
            rate = (self._here - 1) / (now - self._began)
            left = timedelta(seconds=round((self._total - self._over) / rate))
            parts += [f"{rate:.3g} per second", f"{left} left"]
        return ", ".join(parts)
