"""Executes all runs of the given papers in parallel and judges their claims."""

import contextlib
import multiprocessing
import os
import signal
import time
from collections.abc import Iterator, Mapping, Sequence
from multiprocessing.pool import AsyncResult, Pool

from msgspec import Struct

from testbed.config import ConfigError
from testbed.core.error import TestbedError
from testbed.reproduction.claim import ClaimRow, Paper, Values, judge, needed
from testbed.reproduction.figure import Figure
from testbed.reproduction.run import Run, execute

CORES = 2  # upper limit: more do not help, because the longest run dominates


class TaskResult(Struct, frozen=True):
    """Measures and figures of one run, and how long it took."""

    paper: str
    run: str
    values: Values
    figures: list[Figure]
    wall_s: float


class Task(Struct, frozen=True):
    """One run of a paper, for a worker."""

    paper: str
    name: str
    run: Run
    quick: bool


class RunError(TestbedError):
    """A run failed; the message names the run and the cause."""


def make(task: Task) -> TaskResult:
    """Execute one run.

    Raises:
        RunError: invalid parameters, or the integration stopped early.
    """
    began = time.perf_counter()
    try:
        values, figures = execute(task.run, quick=task.quick)
    except (ValueError, ArithmeticError, RuntimeError, ConfigError) as error:
        raise RunError(f"run {task.name} of {task.paper}: {error}") from None
    return TaskResult(task.paper, task.name, values, figures, time.perf_counter() - began)


def tasks_of(papers: Mapping[str, Paper], *, quick: bool) -> list[Task]:
    """The runs that claims need, grouped by kind and law.

    The first run of a law compiles it; two processes would both compile the same law.
    """
    tasks = [
        Task(key, name, run, quick)
        for key, paper in papers.items()
        for name, run in paper.runs.items()
        if any(name in needed(claim) for claim in paper.claims)
    ]
    return sorted(tasks, key=lambda task: (_kind(task.run), task.paper, task.name))


def _kind(run: Run) -> str:
    return f"{type(run).__name__} {type(getattr(run, 'controller', None)).__name__}"


def _ignore_interrupt() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the parent process


@contextlib.contextmanager
def _pool(size: int) -> Iterator[Pool]:
    pool = multiprocessing.get_context("spawn").Pool(size, _ignore_interrupt)
    try:
        yield pool
    finally:
        pool.terminate()
        pool.join()


def grouped(tasks: Sequence[Task]) -> list[list[Task]]:
    """Groups of tasks of the same kind, those with the most work first."""
    groups: dict[str, list[Task]] = {}
    for task in tasks:
        groups.setdefault(_kind(task.run), []).append(task)
    return sorted(groups.values(), key=len, reverse=True)


def made(tasks: Sequence[Task], cores: int | None = None) -> Iterator[TaskResult]:
    """Execute runs and yield results as they complete; the caller may stop at any time.

    The first run of each kind compiles code for the others, which wait for it.
    """
    size = min(cores or os.cpu_count() or 1, CORES, len(tasks))
    if size <= 1:
        yield from map(make, tasks)
        return
    groups = grouped(tasks)
    with _pool(size) as pool:
        pioneers = {id(group): pool.apply_async(make, (group[0],)) for group in groups}
        waiting = list(groups)
        followers: list[AsyncResult[TaskResult]] = []
        while waiting or followers:
            for group in [g for g in waiting if pioneers[id(g)].ready()]:
                waiting.remove(group)
                yield pioneers[id(group)].get()
                followers += [pool.apply_async(make, (task,)) for task in group[1:]]
            for result in [r for r in followers if r.ready()]:
                followers.remove(result)
                yield result.get()
            for result in [*followers, *(pioneers[id(g)] for g in waiting)][:1]:
                result.wait(0.05)


def rows_of(
    key: str, paper: Paper, values: Mapping[str, Values], *, quick: bool
) -> tuple[list[ClaimRow], list[str]]:
    """The rows of a paper, and the ids of claims whose runs were not executed."""
    rows, missing = [], []
    for claim in paper.claims:
        if any(name not in values for name in needed(claim)):
            missing.append(f"{key}.{claim.id}")
        else:
            rows.append(judge(key, paper, claim, values, quick=quick))
    return rows, missing
