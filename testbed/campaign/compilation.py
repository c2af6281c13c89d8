"""Machine code is made once, in a process of its own, before workers start.

A compiler takes 300 MB that a worker would keep to its end, and each worker would compile the same.
"""

import signal
from collections.abc import Callable, Sequence
from multiprocessing import get_context
from pathlib import Path

from numba.core import config

from testbed.campaign.code import code_digest, digest_of
from testbed.campaign.row import Task

Warm = Callable[[str, Sequence[Task]], None]


def compile_first(base: str, tasks: Sequence[Task], warm: Warm) -> None:
    """Have on disk what these tasks need compiled; at once if it is there.

    Args:
        base: the experiment.
        tasks: one for each law and mode.
        warm: flies a moment of each.
    """
    folder = vars(config)["CACHE_DIR"]
    key = digest_of(f"{code_digest()} {base} {tasks}".encode())
    mark = Path(folder) / "campaigns" / key if folder else None
    if mark and mark.exists():
        return
    process = get_context("spawn").Process(target=_run, args=(warm, base, tasks), daemon=True)
    process.start()
    try:
        process.join()
    finally:
        process.kill()  # of use only when interrupted
    if mark and process.exitcode == 0:
        mark.parent.mkdir(parents=True, exist_ok=True)
        mark.touch()


def _run(warm: Warm, base: str, tasks: Sequence[Task]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # go without a word
    warm(base, tasks)
