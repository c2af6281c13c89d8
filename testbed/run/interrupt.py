"""Ctrl-C, SIGTERM and a closed terminal during a run, counted; files are always finished.

The first ends the flight after its tick: the vehicles brake and land. The second Ctrl-C shuts
valves and air at once.
"""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from testbed.realtime.heartbeat import heartbeat
from testbed.realtime.law_watch import hurry


class Interrupt:
    """Requests to end the run, by a signal or by the caller."""

    def __init__(self) -> None:
        self.asked = 0  # times
        self._raises = False
        self._terminals: list[int] = []

    def _handle(self, number: int, frame: FrameType | None) -> None:
        # a closed terminal may be told twice, by the system and by the shell: not impatience
        self.asked = self.asked + 1 if number == signal.SIGINT else max(1, self.asked)
        heartbeat().signalled()
        hurry()
        if number == signal.SIGHUP:
            self._leave_terminal()
        if self._raises:
            raise KeyboardInterrupt

    def _leave_terminal(self) -> None:
        """Write nowhere what was for a terminal that was closed, so that nothing fails at it."""
        for descriptor in self._terminals:
            if not os.isatty(descriptor):
                os.dup2(os.open(os.devnull, os.O_RDWR), descriptor)

    @contextmanager
    def caught(self) -> Iterator[None]:
        """Note signals meanwhile; the handlers that were there before are put back.

        A closed terminal is noted only where it would end the command.
        """
        self._terminals = [descriptor for descriptor in (0, 1, 2) if os.isatty(descriptor)]
        numbers = [signal.SIGINT, signal.SIGTERM]
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # as under nohup
            numbers.append(signal.SIGHUP)
        before = {number: signal.signal(number, self._handle) for number in numbers}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """Interrupt at once something long that leaves no files, such as compiling."""
        self._raises = not self.asked
        try:
            yield
        except KeyboardInterrupt:
            self.asked = max(1, self.asked)
        finally:
            self._raises = False
