"""A `Timer` that a test moves: threads that wait for it run one step after the other.

So what a plug-in's thread does at a time is the same on every machine, however busy.
"""

import threading
from collections.abc import Collection

from testbed.conformance.check import PATIENCE_S, must


class ManualClock:
    """Starts at 1000 s and stands still until it is moved."""

    def __init__(self) -> None:
        self._now, self._free = 1000.0, False
        self._change = threading.Condition()
        self._waiting: dict[threading.Thread, float] = {}  # until when
        self._known: set[threading.Thread] = set()  # all that have ever waited

    @property
    def now(self) -> float:
        """See `Timer`."""
        with self._change:
            return self._now

    def wait_until(self, t: float) -> None:
        """See `Clock`."""
        me = threading.current_thread()
        with self._change:
            if not self._free and self._now < t:
                self._known.add(me)
                self._waiting[me] = t
                self._change.notify_all()
                while not self._free and self._now < t:
                    self._change.wait()
            if self._free:
                self._now = max(self._now, t)

    def meet(self, threads: Collection[threading.Thread]) -> None:
        """Wait until one of the threads waits for this clock, if there are any."""
        with self._change:
            alive = [one for one in threads if one.is_alive()]
            came = not alive or self._change.wait_for(
                lambda: self._known & set(alive) or not any(t.is_alive() for t in alive), PATIENCE_S
            )
        must(came, "a thread of the plug-in", "clock.wait_until to be called", "another wait")

    def advance(self, seconds: float) -> None:
        """Let time pass; on return every thread waits for a later time."""
        with self._change:
            end = self._now + seconds
            while True:
                self._settle()
                due = [t for t in self._waiting.values() if t <= end]
                if not due:
                    break
                self._now = max(self._now, min(due))
                for thread, t in list(self._waiting.items()):
                    if t <= self._now:
                        del self._waiting[thread]
                self._change.notify_all()
            self._now = end

    def _settle(self) -> None:
        def all_wait() -> bool:
            return all(one in self._waiting or not one.is_alive() for one in self._known)

        for _ in range(round(PATIENCE_S / 0.1)):  # a thread that ends does not report it
            if self._change.wait_for(all_wait, 0.1):
                return
        must(False, "a thread of the plug-in", "clock.wait_until to be called again", "no call")

    def let_go(self) -> None:
        """Remove the limit: time jumps to each thread's deadline."""
        with self._change:
            self._free = True
            self._change.notify_all()
