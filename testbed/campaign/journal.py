"""Append-only record of a campaign that survives a kill.

Each line is one JSON message after its checksum. One system call writes a line, so a kill leaves
complete lines and at most one torn line at the end, which is cut off at the next start. Only one
process may write at a time. The head identifies the campaign and the code.
"""

import errno
import fcntl
import os
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Generic, TypeVar

import msgspec
from msgspec import Struct

from testbed.core.error import TestbedError

Message = TypeVar("Message", bound=Struct)

SYNC_S = 1.0  # a power cut loses at most the runs of this time [s]


class JournalError(TestbedError):
    """The journal cannot be used."""


class Head(Struct, frozen=True):
    """First line: identifies the campaign and the code of the other lines."""

    campaign: str  # digest of everything that determines what is flown
    code: str  # digest of the code that flies it
    version: int = 1


class Journal(Generic[Message]):
    """The journal at `path`; a context manager with an exclusive lock."""

    def __init__(
        self,
        path: Path,
        head: Head,
        kind: type[Message],
        difference: Callable[[], str] = lambda: "another",
    ) -> None:
        self._path, self._head, self._kind = path, head, kind
        self._difference = difference  # describes how another campaign differs
        self._synced = 0.0

    def __enter__(self) -> "Journal[Message]":
        try:
            self._file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self._file)
            raise JournalError(f"{self._path}: another process is flying this campaign") from None
        except OSError as error:
            raise JournalError(f"{self._path}: {error.strerror}") from None
        try:
            self.found = list(self._open())
        except BaseException:
            os.close(self._file)
            raise
        return self

    def __exit__(self, *_: object) -> None:
        os.fsync(self._file)
        os.close(self._file)

    def _open(self) -> Iterator[Message]:
        """Read the existing messages; cuts off a torn last line."""
        data = self._path.read_bytes()
        whole = data.rfind(b"\n") + 1
        if whole < len(data):
            os.ftruncate(self._file, whole)
        lines = data[:whole].splitlines()
        if not lines:
            self._append(self._head)
            return
        head: Head = self._read(lines[0], 1, Head)
        if head.version != self._head.version:
            raise JournalError(f"{self._path}: written by another version of this program")
        for what, is_so, found in (
            ("campaign or experiment has", head.campaign == self._head.campaign, self._difference),
            ("code of laws, flight or twin has", head.code == self._head.code, lambda: "another"),
        ):
            if not is_so:
                raise JournalError(
                    where=f"{self._path}: the {what} changed since these {len(lines) - 1} runs "
                    "were flown",
                    expected="no change, or another folder (--out)",
                    found=f"{found()}: runs of both would be mixed",
                )
        for number, line in enumerate(lines[1:], 2):
            yield self._read(line, number, self._kind)

    def _read(self, line: bytes, number: int, kind: type[Any]) -> Any:
        check, _, text = line.partition(b" ")
        try:
            if int(check, 16) == zlib.crc32(text):
                return msgspec.json.decode(text, type=kind)
        except (ValueError, msgspec.DecodeError):
            pass
        cure = "delete the line to fly its run again, or start anew (--out)"
        if kind is Head:
            cure = "start anew (--out)"
        raise JournalError(
            where=f"{self._path}: line {number} is damaged", expected="an undamaged journal",
            found=repr(line[:60].decode(errors="replace")), hint=cure,
        )  # fmt: skip

    def _append(self, message: Struct) -> None:
        text = msgspec.json.encode(message)
        line = b"%08x %b\n" % (zlib.crc32(text), text)
        before = os.fstat(self._file).st_size
        try:
            if os.write(self._file, line) != len(line):
                os.ftruncate(self._file, before)
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            now = time.monotonic()
            if now - self._synced > SYNC_S:
                os.fsync(self._file)
                self._synced = now
        except OSError as error:
            raise JournalError(f"{self._path}: {error.strerror}") from None

    def append(self, message: Message) -> None:
        """Append one message; after this returns, it survives a kill."""
        self._append(message)
