"""What a process that flies leaves in shared memory for the one that looks after it.

Written by one process, read by another, without a lock: a value that is read while it is written is
read again a moment later. It outlives the writer, however that one ends. By default nobody reads.
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


class Phase(IntEnum):
    """How far a run is."""

    STARTING = 0  # nothing of the user's own has been read
    READING = 1  # the experiment and the file of its law
    COMPILING = 2  # the flight begins soon
    FLYING = 3
    ENDING = 4  # files are finished


class Heartbeat:
    """One process's."""

    def __init__(self, memory: Memory | None = None) -> None:
        self._memory: Memory = bytearray(SIZE) if memory is None else memory
        self._beats = 0

    # Written by the process that flies

    def beat(self) -> None:
        """It is alive."""
        self._beats += 1
        struct.pack_into("<Q", self._memory, 0, self._beats)

    def enter(self, vehicle: bytes) -> None:
        """A call of the law begins."""
        self._beats += 1
        _PULSE.pack_into(self._memory, 0, self._beats, 1, vehicle)

    def leave(self) -> None:
        """It has returned."""
        self._beats += 1
        struct.pack_into("<QB", self._memory, 0, self._beats, 0)

    def signalled(self) -> None:
        """It has noted a signal."""
        _SIGNALS.pack_into(self._memory, _AT_SIGNALS, self.signals + 1)

    def finished(self, code: int) -> None:
        """All is done, and the process ends with this exit code."""
        _RESULT.pack_into(self._memory, _AT_RESULT, 1, code)

    # Read by the other

    @property
    def beats(self) -> int:
        """Changes while the process is alive."""
        return int(struct.unpack_from("<Q", self._memory, 0)[0])

    @property
    def inside(self) -> str | None:
        """The vehicle whose law is being called; None: no law is."""
        _, inside, vehicle = _PULSE.unpack_from(self._memory, 0)
        return vehicle.rstrip(b"\0").decode(errors="replace") if inside else None

    @property
    def signals(self) -> int:
        """How many it has noted."""
        return int(_SIGNALS.unpack_from(self._memory, _AT_SIGNALS)[0])

    @property
    def result(self) -> int | None:
        """The exit code, when all was done."""
        finished, code = _RESULT.unpack_from(self._memory, _AT_RESULT)
        return code if finished else None

    # Both

    @property
    def phase(self) -> Phase:
        """How far the run is."""
        return Phase(self._memory[_AT_PHASE])

    @phase.setter
    def phase(self, phase: Phase) -> None:
        self._memory[_AT_PHASE] = phase
        self.beat()

    @property
    def limits(self) -> tuple[float, float]:
        """Of a call of the law: how long [s], and how much memory it may add [MB]."""
        limit_s, memory_mb = _LIMITS.unpack_from(self._memory, _AT_LIMITS)
        return limit_s, memory_mb

    @limits.setter
    def limits(self, limits: tuple[float, float]) -> None:
        _LIMITS.pack_into(self._memory, _AT_LIMITS, *limits)

    @property
    def law(self) -> str:
        """The law's file, or what it is called."""
        return self._text(_AT_LAW, _LAW_SIZE)

    @law.setter
    def law(self, name: str) -> None:
        self._put(_AT_LAW, _LAW_SIZE, name)

    @property
    def rig(self) -> str:
        """What is flown on."""
        return self._text(_AT_RIG, _RIG_SIZE)

    @rig.setter
    def rig(self, name: str) -> None:
        self._put(_AT_RIG, _RIG_SIZE, name)

    @property
    def folder(self) -> str:
        """Of the run; empty before there is one."""
        return self._text(_AT_FOLDER, _FOLDER_SIZE)

    @folder.setter
    def folder(self, path: str) -> None:
        self._put(_AT_FOLDER, _FOLDER_SIZE, path)

    def _text(self, at: int, size: int) -> str:
        return os.fsdecode(bytes(self._memory[at : at + size]).rstrip(b"\0"))

    def _put(self, at: int, size: int, text: str) -> None:
        self._memory[at : at + size] = os.fsencode(text)[:size].ljust(size, b"\0")


_own = Heartbeat()
_parent = 0  # process that looks after this one; 0: none


def heartbeat() -> Heartbeat:
    """This process's."""
    return _own


def attach(heartbeat: Heartbeat, parent: int = 0) -> None:
    """From now on this process writes here; `parent` looks after it."""
    global _own, _parent
    _own, _parent = heartbeat, parent


def process_to_end() -> int:
    """Which process is to be told that the run shall end."""
    return _parent or os.getpid()


def in_file(path: Path) -> Heartbeat:
    """A heartbeat in a file, for processes that do not come from one another."""
    with path.open("a+b") as file:
        file.truncate(SIZE)
        return Heartbeat(mmap.mmap(file.fileno(), SIZE))
