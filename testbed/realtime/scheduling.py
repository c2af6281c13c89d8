"""Memory and scheduling priority of a process during a flight."""

import ctypes
import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

KEPT = 16 * 2**20  # freed memory that is not given back to the system [bytes]
TRIM, MAP = -1, -3  # M_TRIM_THRESHOLD and M_MMAP_THRESHOLD of mallopt(3)


@cache
def _keep_freed_memory() -> None:
    """Let the heap of glibc keep freed memory and use it again.

    By default it gives much of it back to the system and asks for new pages for the next table of
    ticks: 2000 pages in a flight with its log, which take a fiftieth of its time.
    """
    with suppress(AttributeError, OSError):  # another C library
        set_option = ctypes.CDLL(None).mallopt
        for option in (TRIM, MAP):
            set_option(option, KEPT)


@contextmanager
def steady_memory() -> Iterator[None]:
    """While open, garbage collection is off; from the first time on, freed memory is kept.

    A flight creates frozen values without cycles, which reference counting frees at once; the
    collector would visit hundreds of thousands of them in vain. A pass before the flight takes a
    tenth of a second and gives nothing back.
    """
    _keep_freed_memory()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def settle() -> None:
    """Exclude modules and compiled code from garbage collection: a pass takes a tenth of a second.

    Call it once, when everything is loaded, in a process that flies often.
    """
    gc.collect()
    gc.freeze()


def _schedule(policy: int, priority: int, process: int | str = "self") -> bool:
    """Set the policy of all threads of a process; whether the system allowed it."""
    try:
        for thread in Path(f"/proc/{process}/task").iterdir():
            with suppress(ProcessLookupError):  # the process has just ended
                os.sched_setscheduler(int(thread.name), policy, os.sched_param(priority))
    except OSError:
        return False
    return True


def prefer_process(pid: int, priority: int) -> bool:
    """Like `realtime_priority`, but permanent and for another process and its children."""
    allowed = _schedule(os.SCHED_FIFO, priority, pid)
    with suppress(OSError):
        for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
            allowed &= prefer_process(int(child), priority)
    return allowed


@contextmanager
def realtime_priority(priority: int) -> Iterator[bool]:
    """While open, all threads have real-time priority; yields whether the system allows it.

    It needs root or an rtprio limit; without it a busy machine delays the flight. Python's switch
    interval is set to 0.5 ms instead of 5 ms, because one thread sends the valve commands.
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
