"""Make all runs of some papers, on all cores, and judge their claims."""

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
from testbed.reproduction.claim import Paper, Row, Values, judge, needed
from testbed.reproduction.figure import Figure
from testbed.reproduction.run import Run, execute

CORES = 2  # at most: more do not help, the longest run decides


class Made(Struct, frozen=True):
    """A run that is done."""

    paper: str
    run: str
    values: Values
    figures: list[Figure]
    wall_s: float


class Task(Struct, frozen=True):
    """A run to be made."""

    paper: str
    name: str
    run: Run
    quick: bool


class RunError(TestbedError):
    """A run could not be made; says which, and why."""


def make(task: Task) -> Made:
    """Make one run.

    Raises:
        RunError: its parameters make no sense, or the integration stopped.
    """
    began = time.perf_counter()
    try:
        values, figures = execute(task.run, quick=task.quick)
    except (ValueError, ArithmeticError, RuntimeError, ConfigError) as error:
        raise RunError(f"run {task.name} of {task.paper}: {error}") from None
    return Made(task.paper, task.name, values, figures, time.perf_counter() - began)


def tasks_of(papers: Mapping[str, Paper], *, quick: bool) -> list[Task]:
    """The runs that a claim asks for, those of one kind and law apart from each other.

    Whoever flies a law first compiles it; two processes at the same law would both do so.
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
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the one who waits


@contextlib.contextmanager
def _pool(size: int) -> Iterator[Pool]:
    pool = multiprocessing.get_context("spawn").Pool(size, _ignore_interrupt)
    try:
        yield pool
    finally:
        pool.terminate()
        pool.join()


def grouped(tasks: Sequence[Task]) -> list[list[Task]]:
    """Tasks of the same kind together, those with the most work first."""
    groups: dict[str, list[Task]] = {}
    for task in tasks:
        groups.setdefault(_kind(task.run), []).append(task)
    return sorted(groups.values(), key=len, reverse=True)


def made(tasks: Sequence[Task], cores: int | None = None) -> Iterator[Made]:
    """Make runs, in whatever order they get done; the caller may stop listening at any time.

    The first of each kind compiles what the others use, so those wait for it.
    """
    size = min(cores or os.cpu_count() or 1, CORES, len(tasks))
    if size <= 1:
        yield from map(make, tasks)
        return
    groups = grouped(tasks)
    with _pool(size) as pool:
        pioneers = {id(group): pool.apply_async(make, (group[0],)) for group in groups}
        waiting = list(groups)
        followers: list[AsyncResult[Made]] = []
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
) -> tuple[list[Row], list[str]]:
    """The rows of a paper, and the ids of the claims whose run was not made."""
    rows, missing = [], []
    for claim in paper.claims:
        if any(name not in values for name in needed(claim)):
            missing.append(f"{key}.{claim.id}")
        else:
            rows.append(judge(key, paper, claim, values, quick=quick))
    return rows, missing
