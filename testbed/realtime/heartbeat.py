"""Shared memory in which a flying process reports its state to its supervisor process.

One process writes and another reads, without a lock: a value that is read while it is written is
corrected by the next read. The memory outlives the writer. By default there is no reader.
"""

import mmap
import os
import struct
from enum import IntEnum
from pathlib import Path

SIZE = 4096
_PULSE = struct.Struct("<QB64s")  # beats, inside a call of the law, vehicle
_RESULT = struct.Struct("<Bi")  # finished, exit code
_SIGNALS = struct.Struct("<Q")
_LIMITS = struct.Struct("<dd")
_AT_RESULT, _AT_SIGNALS, _AT_PHASE, _AT_LIMITS = 80, 96, 104, 112
_AT_LAW, _LAW_SIZE = 128, 256
_AT_RIG, _RIG_SIZE = 400, 16
_AT_FOLDER, _FOLDER_SIZE = 512, 3584

Memory = bytearray | mmap.mmap


class RunPhase(IntEnum):
    """Phase of a run's process, for the process that supervises it."""

    STARTING = 0  # no file of the user has been read yet
    READING = 1  # reads the experiment and the law's file
    COMPILING = 2  # compiles before the flight
    FLYING = 3
    ENDING = 4  # writes its files


class Heartbeat:
    """The heartbeat of one process."""

    def __init__(self, memory: Memory | None = None) -> None:
        self._memory: Memory = bytearray(SIZE) if memory is None else memory
        self._beats = 0

    # Written by the process that flies

    def beat(self) -> None:
        """Show that the process is alive."""
        self._beats += 1
        struct.pack_into("<Q", self._memory, 0, self._beats)

    def enter(self, vehicle: bytes) -> None:
        """Mark the start of a call of the law."""
        self._beats += 1
        _PULSE.pack_into(self._memory, 0, self._beats, 1, vehicle)

    def leave(self) -> None:
        """Mark the end of a call of the law."""
        self._beats += 1
        struct.pack_into("<QB", self._memory, 0, self._beats, 0)

    def signalled(self) -> None:
        """Count a received signal."""
        _SIGNALS.pack_into(self._memory, _AT_SIGNALS, self.signals + 1)

    def finished(self, code: int) -> None:
        """Mark the process as finished, with its exit code."""
        _RESULT.pack_into(self._memory, _AT_RESULT, 1, code)

    # Read by the other

    @property
    def beats(self) -> int:
        """Counter that changes while the process is alive."""
        return int(struct.unpack_from("<Q", self._memory, 0)[0])

    @property
    def inside(self) -> str | None:
        """The vehicle whose law is being called; None: no call is active."""
        _, inside, vehicle = _PULSE.unpack_from(self._memory, 0)
        return vehicle.rstrip(b"\0").decode(errors="replace") if inside else None

    @property
    def signals(self) -> int:
        """Number of received signals."""
        return int(_SIGNALS.unpack_from(self._memory, _AT_SIGNALS)[0])

    @property
    def result(self) -> int | None:
        """The exit code if the process has finished."""
        finished, code = _RESULT.unpack_from(self._memory, _AT_RESULT)
        return code if finished else None

    # Both

    @property
    def phase(self) -> RunPhase:
        """Phase of the run, as written by its process."""
        return RunPhase(self._memory[_AT_PHASE])

    @phase.setter
    def phase(self, phase: RunPhase) -> None:
        self._memory[_AT_PHASE] = phase
        self.beat()

    @property
    def limits(self) -> tuple[float, float]:
        """Limits of the law: time of a call [s], memory added by its calls [MB]."""
        limit_s, memory_mb = _LIMITS.unpack_from(self._memory, _AT_LIMITS)
        return limit_s, memory_mb

    @limits.setter
    def limits(self, limits: tuple[float, float]) -> None:
        _LIMITS.pack_into(self._memory, _AT_LIMITS, *limits)

    @property
    def law(self) -> str:
        """The law's file or name."""
        return self._text(_AT_LAW, _LAW_SIZE)

    @law.setter
    def law(self, name: str) -> None:
        self._put(_AT_LAW, _LAW_SIZE, name)

    @property
    def rig(self) -> str:
        """Name of the rig, for the report of a dead run."""
        return self._text(_AT_RIG, _RIG_SIZE)

    @rig.setter
    def rig(self, name: str) -> None:
        self._put(_AT_RIG, _RIG_SIZE, name)

    @property
    def folder(self) -> str:
        """Run folder; empty before it exists."""
        return self._text(_AT_FOLDER, _FOLDER_SIZE)

    @folder.setter
    def folder(self, path: str) -> None:
        self._put(_AT_FOLDER, _FOLDER_SIZE, path)

    def _text(self, at: int, size: int) -> str:
        return os.fsdecode(bytes(self._memory[at : at + size]).rstrip(b"\0"))

    def _put(self, at: int, size: int, text: str) -> None:
        self._memory[at : at + size] = os.fsencode(text)[:size].ljust(size, b"\0")


_own = Heartbeat()
_parent = 0  # supervisor process; 0: none


def heartbeat() -> Heartbeat:
    """The heartbeat of this process."""
    return _own


def attach(heartbeat: Heartbeat, parent: int = 0) -> None:
    """Set this process's heartbeat and its supervisor process `parent`."""
    global _own, _parent
    _own, _parent = heartbeat, parent


def process_to_end() -> int:
    """Process id to signal to end the run."""
    return _parent or os.getpid()


def in_file(path: Path) -> Heartbeat:
    """A heartbeat in a file, for processes that do not share a parent."""
    with path.open("a+b") as file:
        file.truncate(SIZE)
        return Heartbeat(mmap.mmap(file.fileno(), SIZE))
