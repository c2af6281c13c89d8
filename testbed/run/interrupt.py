"""Ctrl-C and SIGTERM during a run: the flight ends after its tick, and files are finished."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class Interrupt:
    """A request to end the run, set by a signal or by the caller."""

    def __init__(self) -> None:
        self.asked = False
        self._raises = False

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
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
            self.asked = True
        finally:
            self._raises = False
