"""Interrupts a law's call in the thread that makes it.

Both alarms call `tick` at an interval while they are set; an error of `tick` is raised in the law.
The signal of `SignalAlarm` also ends waits such as `time.sleep`, but Python delivers signals only
to the main thread. `ThreadAlarm` works in any thread; its error is raised at the next line of
Python, so it does not end waits. Neither ends compiled code.
"""

import ctypes
import math
import signal
import threading
import time
from collections.abc import Callable
from typing import Protocol

from controllers.law_file import LawStoppedError

LOOK_S = 0.05  # interval at which `ThreadAlarm` looks at the clock [s]


class Alarm(Protocol):
    """Calls `tick` at an interval."""

    def set(self, interval_s: float) -> None:
        """Begin anew with this interval [s]; 0 switches the alarm off."""
        ...

    def close(self) -> None:
        """End the alarm."""
        ...


class SignalAlarm:
    """An alarm for the main thread."""

    def __init__(self, tick: Callable[[], None]) -> None:
        self._before = signal.signal(signal.SIGALRM, lambda number, frame: tick())

    def set(self, interval_s: float) -> None:
        """See `Alarm`."""
        signal.setitimer(signal.ITIMER_REAL, interval_s, interval_s)

    def close(self) -> None:
        """See `Alarm`."""
        self.set(0.0)
        signal.signal(signal.SIGALRM, self._before)


class ThreadAlarm:
    """An alarm for the thread that makes it."""

    def __init__(self, tick: Callable[[], None]) -> None:
        self._tick, self._thread = tick, ctypes.c_ulong(threading.get_ident())
        self._lock, self._closed = threading.Lock(), threading.Event()
        self._due, self._interval = math.inf, 0.0
        self._raised = False
        threading.Thread(target=self._look, name="law alarm", daemon=True).start()

    def set(self, interval_s: float) -> None:
        """See `Alarm`."""
        with self._lock:
            self._interval = interval_s
            self._due = time.monotonic() + interval_s if interval_s > 0.0 else math.inf
            if self._raised:  # an error that has not been raised yet must not be raised later
                self._raised = False
                ctypes.pythonapi.PyThreadState_SetAsyncExc(self._thread, None)

    def close(self) -> None:
        """See `Alarm`."""
        self.set(0.0)
        self._closed.set()

    def _look(self) -> None:
        while not self._closed.wait(LOOK_S):
            with self._lock:
                if time.monotonic() < self._due:
                    continue
                self._due += self._interval
                try:
                    self._tick()
                except LawStoppedError as error:
                    self._raised = True
                    late = ctypes.py_object(_with_text(str(error)))
                    ctypes.pythonapi.PyThreadState_SetAsyncExc(self._thread, late)


def _with_text(text: str) -> type[LawStoppedError]:
    """A class of errors with this text: another thread can raise only a class."""

    class LateLawError(LawStoppedError):
        def __str__(self) -> str:
            return text

    return LateLawError


def make_alarm(tick: Callable[[], None]) -> Alarm:
    """The alarm for this thread."""
    here = threading.current_thread() is threading.main_thread()
    return SignalAlarm(tick) if here else ThreadAlarm(tick)
