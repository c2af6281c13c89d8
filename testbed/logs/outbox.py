"""Bytes on their way to a pipe."""

import fcntl
import os
from collections import deque
from contextlib import suppress
from itertools import islice
from typing import IO

AT_ONCE = 256  # most pieces in one call; the system takes 1024


class Outbox:
    """Bytes for a pipe, in order. Large memory is not copied: it must not change any more."""

    def __init__(self) -> None:
        self.size = 0  # [bytes]
        self._pieces: deque[bytearray | memoryview] = deque()
        self._end = bytearray()  # after the pieces

    def add(self, data: bytes) -> None:
        """Append a few bytes."""
        self._end += data
        self.size += len(data)

    def add_memory(self, data: memoryview) -> None:
        """Append a view of bytes, by reference."""
        self._close_piece()
        if len(data):
            self._pieces.append(data)
            self.size += len(data)

    def write_to(self, descriptor: int) -> int:
        """Write what the pipe takes without waiting; returns the number of bytes."""
        self._close_piece()
        before = self.size
        with suppress(BlockingIOError):
            while self._pieces:
                self._drop(os.writev(descriptor, list(islice(self._pieces, AT_ONCE))))
        return before - self.size

    def clear(self) -> None:
        """Drop everything."""
        self.size, self._end = 0, bytearray()
        self._pieces.clear()

    def _close_piece(self) -> None:
        if self._end:
            self._pieces.append(self._end)
            self._end = bytearray()

    def _drop(self, number: int) -> None:
        """Drop the first bytes."""
        self.size -= number
        while number > 0:
            piece = self._pieces.popleft()
            if number < len(piece):
                self._pieces.appendleft(memoryview(piece)[number:])
            number -= len(piece)


def widen(pipe: IO[bytes] | None, size: int) -> None:
    """Give a pipe this size [bytes], or a quarter; the system's, if its limits are lower."""
    for one in (size, size // 4):
        with suppress(OSError, AttributeError):  # too large for this user; not Linux
            fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, one)  # type: ignore[arg-type]
            return
