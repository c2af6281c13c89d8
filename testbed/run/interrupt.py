"""Counts Ctrl-C, SIGTERM and SIGHUP during a run; files are always finished.

The first signal ends the flight after its tick: the vehicles brake and land. A second Ctrl-C closes
valves and air at once.
"""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from testbed.realtime.heartbeat import heartbeat
from testbed.realtime.law_watch import shorten_limit

AGAIN_S = 0.01
CALLBACKS = "_raw_object_cache"  # functions that LLVM calls when it has compiled
EVENTS = "numba/core/event.py"  # its listeners run where an exception may be dropped, too


class Interrupt:
    """Requests to end the run, by a signal or by the caller.

    Args:
        heard: called after each signal.
    """

    def __init__(self, heard: Callable[[], None] = lambda: None) -> None:
        self.asked = 0  # number of requests
        self._heard = heard
        self._raises = False
        self._again = False  # the next signal is sent by this class
        self._terminals: list[int] = []

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self._again:
            self._again = False
        else:
            self._count(number)
        if not self._raises:
            return
        if _is_callback(frame):  # Python would drop the exception, and what the compiler has made
            self._again = True
            threading.Timer(AGAIN_S, os.kill, (os.getpid(), number)).start()
            return
        raise KeyboardInterrupt

    def _count(self, number: int) -> None:
        # system and shell may both signal a closed terminal, so SIGHUP does not count twice
        self.asked = self.asked + 1 if number == signal.SIGINT else max(1, self.asked)
        heartbeat().signalled()
        shorten_limit()
        self._heard()
        if number == signal.SIGHUP:
            self._leave_terminal()

    def _leave_terminal(self) -> None:
        """Redirect the output of a closed terminal to /dev/null, so that no write fails."""
        for descriptor in self._terminals:
            if not os.isatty(descriptor):
                os.dup2(os.open(os.devnull, os.O_RDWR), descriptor)

    @contextmanager
    def caught(self) -> Iterator[None]:
        """Count signals in this context, then restore the previous handlers.

        A Ctrl-C that killed the process before raises KeyboardInterrupt afterwards: the files are
        there then, and the exit code must be. SIGHUP is counted only if it would end the command.
        """
        self._terminals = [descriptor for descriptor in (0, 1, 2) if os.isatty(descriptor)]
        numbers = [signal.SIGINT, signal.SIGTERM]
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # as under nohup
            numbers.append(signal.SIGHUP)
        before = {number: signal.signal(number, self._handle) for number in numbers}
        try:
            yield
        finally:
            if before[signal.SIGINT] is signal.SIG_DFL:
                before[signal.SIGINT] = signal.default_int_handler
            for number, handler in before.items():
                signal.signal(number, handler)

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """Context in which a signal interrupts at once; for long work without files."""
        self._raises = not self.asked
        try:
            yield
        except KeyboardInterrupt:
            self.asked = max(1, self.asked)
        finally:
            self._raises = False


@contextmanager
def held_back() -> Iterator[None]:
    """Context in which this thread, its new threads and its new processes get no Ctrl-C or SIGTERM.

    A signal that comes meanwhile is handled at the end; new threads and processes never get it.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _is_callback(frame: FrameType | None) -> bool:
    """Whether a function that the compiler calls is running."""
    while frame is not None:
        code = frame.f_code
        if code.co_name.startswith(CALLBACKS) or code.co_filename.endswith(EVENTS):
            return True
        frame = frame.f_back
    return False
