"""Ctrl-C and SIGTERM during a run, counted; files are always finished.

The first ends the flight after its tick: the vehicles brake and land. The second shuts valves and
air at once.
"""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class Interrupt:
    """Requests to end the run, by a signal or by the caller."""

    def __init__(self) -> None:
        self.asked = 0  # times
        self._raises = False

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self.asked += 1
        if self._raises:
            raise KeyboardInterrupt

    @contextmanager
    def caught(self) -> Iterator[None]:
        """Note signals meanwhile; the handlers that were there before are put back."""
        before = {n: signal.signal(n, self._handle) for n in (signal.SIGINT, signal.SIGTERM)}
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
