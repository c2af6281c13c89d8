"""Compiles machine code once, in a separate process, before workers start.

The compiler takes 300 MB, which a worker would keep, and each worker would compile the same code.
"""

import os
import signal
from collections.abc import Callable, Sequence
from multiprocessing import get_context, resource_tracker
from pathlib import Path

from numba.core import config

from testbed.campaign.row import Task
from testbed.config import Experiment
from testbed.run.code_digest import code_digest
from testbed.run.interrupt import held_back

Warm = Callable[[str, Sequence[Task]], None]
Read = Callable[[str, Sequence[str]], Experiment]


def compile_first(base: str, tasks: Sequence[Task], read: Read, warm: Warm, limit_s: float) -> None:
    """Compile what these tasks need into the cache on disk; returns at once if it is there.

    Args:
        base: the experiment.
        tasks: some tasks of each law and mode.
        read: makes the experiment of a task.
        warm: flies each task for a moment.
        limit_s: time limit; what takes longer is compiled by the workers [s].
    """
    folder = vars(config)["CACHE_DIR"]
    marks: dict[Path, Task] = {}
    for task in tasks:
        mark = Path(folder or ".") / "campaigns" / kind_of(read(base, task[1]))
        if not (folder and mark.exists()):
            marks.setdefault(mark, task)
    if not marks:
        return
    words = (warm, base, list(marks.values()))
    process = get_context("spawn").Process(target=_run, args=words, daemon=True)
    resource_tracker.ensure_running()  # its start lets signals through again
    with held_back():  # a Ctrl-C before `_run` would print a traceback
        process.start()
    try:
        process.join(limit_s)
    finally:
        process.kill()  # needed only after an interrupt, or if a law never returns
    if folder and process.exitcode == 0:
        for mark in marks:
            mark.parent.mkdir(parents=True, exist_ok=True)
            mark.touch()


def kind_of(experiment: Experiment) -> str:
    """A name for experiments that need the same machine code."""
    law = type(experiment.controller).__struct_config__.tag
    modulator = type(experiment.flight.modulator).__struct_config__.tag
    alone = "one" if len(experiment.vehicles) == 1 else "several"
    where = f"{experiment.guidance.mode}-{experiment.deploy.law}"
    return f"{code_digest()}-{law}-{where}-{modulator}-{alone}"


def _run(warm: Warm, base: str, tasks: Sequence[Task]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # end silently
    signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT, signal.SIGTERM))  # of `held_back`
    os.dup2(2, 1)  # keeps a law's prints out of the result
    warm(base, tasks)
