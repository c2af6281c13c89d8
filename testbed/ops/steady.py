"""The process while it flies: what would make it stumble is handled here and nowhere else."""

import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def steady() -> Iterator[None]:
    """No garbage collection meanwhile.

    A flight makes frozen values without cycles, which reference counting frees at once; the
    collector would walk hundreds of thousands of them to find nothing.
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()


def prefer(priority: int) -> bool:
    """Run all threads before everything ordinary, where the system allows it: root, or an rtprio.

    Threads of Python hand over within half a millisecond then, not five: one of them sends the
    valve commands. Returns whether the system allowed it; without it a busy machine is felt.
    """
    sys.setswitchinterval(0.0005)
    try:
        for thread in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(thread.name), os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        return False
    return True
