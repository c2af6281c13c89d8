"""The process while it flies: what would make it stumble is handled here and nowhere else."""

import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def no_garbage_collection() -> Iterator[None]:
    """No garbage collection meanwhile.

    A flight makes frozen values without cycles, which reference counting frees at once; the
    collector would walk hundreds of thousands of them to find nothing.
    """
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def settle() -> None:
    """Take modules and machine code for lasting: to walk them takes a tenth of a second each time.

    For a process that flies often, once, when everything is loaded.
    """
    gc.collect()
    gc.freeze()


def _schedule(policy: int, priority: int, process: int | str = "self") -> bool:
    """All threads of a process; whether the system allowed it."""
    try:
        for thread in Path(f"/proc/{process}/task").iterdir():
            with suppress(ProcessLookupError):  # it has just ended
                os.sched_setscheduler(int(thread.name), policy, os.sched_param(priority))
    except OSError:
        return False
    return True


def prefer_process(pid: int, priority: int) -> bool:
    """As `realtime_priority`, for good, for another process and what it has started."""
    allowed = _schedule(os.SCHED_FIFO, priority, pid)
    with suppress(OSError):
        for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
            allowed &= prefer_process(int(child), priority)
    return allowed


@contextmanager
def realtime_priority(priority: int) -> Iterator[bool]:
    """Run all threads before everything ordinary meanwhile; gives whether the system allows it.

    It takes root or an rtprio limit; without, a busy machine is felt. Threads of Python hand over
    within half a millisecond then, not five: one of them sends the valve commands.
    """
    interval = sys.getswitchinterval()
    sys.setswitchinterval(0.0005)
    allowed = _schedule(os.SCHED_FIFO, priority)
    try:
        yield allowed
    finally:
        if allowed:
            _schedule(os.SCHED_OTHER, 0)
        sys.setswitchinterval(interval)
