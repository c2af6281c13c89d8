"""Log of record: every tick's inputs and outputs in one MCAP file.

    /<vehicle>/tick    one tick of the flight chain: inputs and outputs
    /<vehicle>/ending  the same after the end of the flight, until its air is off
    /<vehicle>/host    one tick of its law, where that runs on the host
    /<vehicle>/valves  what its board drove, where firmware is in the loop
    /<vehicle>/pace    how its ticks keep their time and how its wires are, where it has any
    /loop              how the host keeps its time, by a real clock
    /supervisor        who may fire, from when on, and why
    /truth             where the vehicles really were; only a twin knows

JSON messages, each topic with the JSON Schema of its struct: any MCAP reader can open it without
this code, and the schemas are so plain that Foxglove reads them (`plain_schema.py`). Times are the
run's, so the same seed gives the same bytes.

The file is written by a process of its own (`mcap_writer.py`) at the other end of a pipe: the
flight does not wait for the disk, and when it is killed, the writer still finishes the file. Every
SPAN_NS of the run a chunk of the file is closed, so a writer that is killed loses no more than that
and what was under way.

The pipe is never waited for on wires, where a flight that waits loses its vehicles: what it does
not take is kept in memory, and beyond LARGEST_BACKLOG rows are lost, which is said. On the twin,
which is faster than any disk, the flight waits for the writer, but not for one that does nothing.
"""

import os
import select
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from time import monotonic
from types import TracebackType

import msgspec
from msgspec import Struct

from testbed.core.error import TestbedError
from testbed.logs.message import to_json
from testbed.logs.plain_schema import plain_schema

BUFFER = 256 * 1024  # [bytes] between the flight and the writer; a third of a second of messages
PIECE = 64 * 1024  # [bytes] that are written at once, between two marks
LARGEST_BACKLOG = 32_000_000  # [bytes] that wait in memory for a writer that does not keep up
LOOK_S = 0.05
PATIENCE_S = 5.0  # for a writer that takes and writes nothing
SPAN_NS = 50_000_000  # of the run between two chunks; the same run gives the same chunks
WARN_BELOW = 500_000_000  # [bytes] free on the disk: say so
END_BELOW = 20_000_000  # [bytes] free on the disk: end the log properly while there is room

READY = b"ready\n"  # the writer's first words


class RecorderError(TestbedError):
    """The log cannot be written, for instance because the disk is full."""


class Motion(Struct, frozen=True, gc=False):
    """Pose and twist of one vehicle in W."""

    x: float  # [m]
    y: float  # [m]
    theta: float  # [rad]
    vx: float  # [m/s]
    vy: float  # [m/s]
    omega: float  # [rad/s]


class Truth(Struct, frozen=True, gc=False):
    """Where the vehicles really are at a tick."""

    t: float  # [s]
    vehicles: dict[str, Motion]


class Topic(Struct, frozen=True, tag=True, array_like=True):
    """To the writer: a new topic; topics are numbered in the order in which they are announced."""

    name: str
    schema_name: str
    schema: bytes


class Entry(Struct, frozen=True, tag=True, array_like=True, gc=False):
    """To the writer: one message of a topic."""

    topic: int
    stamp: int  # [ns]
    data: bytes


class Mark(Struct, frozen=True, tag=True, array_like=True, gc=False):
    """To the writer: put everything so far where a reader finds it."""


Frame = Topic | Entry | Mark


class Recorder:
    """Writes a log; a context manager that finishes the file however the flight ends.

    Args:
        path: of the new file.
        waits: for a writer that does not keep up; else rows are lost then.
        warn_below, end_below: room on the disk [bytes].

    Raises:
        RecorderError: on leaving or writing, when the writer could not do its work.
    """

    def __init__(
        self,
        path: Path,
        warn_below: int = WARN_BELOW,
        end_below: int = END_BELOW,
        vehicles: Sequence[str] = (),
        *,
        waits: bool = True,
    ) -> None:
        self._path, self._waits = path, waits
        self.lost = 0  # rows
        self._told = False  # that rows are lost
        self._pending = bytearray()  # not taken by the pipe yet
        self._command = [
            *(sys.executable, "-m", "testbed.logs.mcap_writer"),
            *(str(path), str(warn_below), str(end_below)),
        ]
        self._marked = -SPAN_NS  # time of the last mark [ns]
        self._said = b""  # by the writer and not yet handed on
        self._reason = ""  # the newest line that it said
        self._encode = msgspec.json.Encoder().encode
        self._pack = msgspec.msgpack.Encoder().encode
        self._topics: dict[str, int] = {}
        self._vehicles = vehicles  # whose names are in the schemas
        self._schemas: dict[type[Struct], bytes] = {}

    def __enter__(self) -> "Recorder":
        self._writer = subprocess.Popen(
            self._command,
            bufsize=0,
            pipesize=BUFFER,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C is for the flight; the writer ends when the pipe does
        )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        said = self._last_words()
        if self._writer.returncode != 0 and kind is None:
            raise RecorderError(said)

    def write(self, topic: str, t: float, message: Struct) -> None:
        """Append one message of time `t` [s] to `topic`."""
        if not self._topics:
            self._meet()
        number = self._topics.get(topic)
        if number is None:
            number = self._topics[topic] = len(self._topics)
            kind = type(message)
            if kind not in self._schemas:
                self._schemas[kind] = self._encode(plain_schema(kind, self._vehicles))
            self._send(Topic(topic, kind.__name__, self._schemas[kind]))
        self._send(Entry(number, round(t * 1e9), to_json(message)))

    def _meet(self) -> None:
        """Wait until the writer has made its file: from then on a kill costs next to nothing."""
        assert self._writer.stdin is not None
        assert self._writer.stderr is not None
        if not select.select([self._writer.stderr], [], [], 4.0 * PATIENCE_S)[0]:
            raise RecorderError(self._give_up("has not started"))
        self._said = self._writer.stderr.readline()
        if self._said != READY:
            raise RecorderError(self._last_words())
        self._said = b""
        os.set_blocking(self._writer.stderr.fileno(), False)
        os.set_blocking(self._writer.stdin.fileno(), False)

    def mark(self, t: float) -> list[str]:
        """A tick is whole: hand it over; what the writer has to say, for instance of the disk.

        Raises:
            RecorderError: the writer has ended; nothing is recorded any more.
        """
        now = round(t * 1e9)
        if now - self._marked >= SPAN_NS:
            self._marked = now
            self._send(Mark())
        assert self._writer.stderr is not None
        self._hand_over()
        try:
            heard = os.read(self._writer.stderr.fileno(), 4096)
        except BlockingIOError:
            return self._losses()  # it has nothing to say
        if not heard:
            raise RecorderError(self._last_words())
        *lines, self._said = (self._said + heard).split(b"\n")
        self._reason = lines[-1].decode() if lines else self._reason
        said = [line.decode() for line in lines if line.startswith(b"warning")]
        return said + self._losses()

    def _losses(self) -> list[str]:
        """Words about rows that are lost, once."""
        if not self.lost or self._told:
            return []
        self._told = True
        return ["warning: the process that writes the log does not keep up; rows of it are lost"]

    def _send(self, frame: Frame) -> None:
        if len(self._pending) > LARGEST_BACKLOG and not isinstance(frame, Topic):
            self.lost += isinstance(frame, Entry)
            return
        packed = self._pack(frame)
        self._pending += len(packed).to_bytes(4, "little")
        self._pending += packed
        if len(self._pending) >= PIECE:
            self._hand_over()

    def _hand_over(self) -> None:
        """Give the pipe what it takes; on the twin, wait for it to take some more.

        Raises:
            RecorderError: the writer has ended, or takes nothing.
        """
        try:
            self._push()
            while self._waits and len(self._pending) > BUFFER:
                if not self._takes_more(PATIENCE_S):
                    raise RecorderError(self._give_up(f"has taken nothing for {PATIENCE_S:g} s"))
                self._push()
        except BrokenPipeError:
            self._pending.clear()
            raise RecorderError(self._last_words()) from None

    def _push(self) -> int:
        """Write what can be written without waiting; how much that was [bytes]."""
        assert self._writer.stdin is not None
        done = 0
        try:
            while self._pending:
                step = os.write(self._writer.stdin.fileno(), self._pending[:BUFFER])
                del self._pending[:step]
                done += step
        except BlockingIOError:
            pass
        return done

    def _takes_more(self, wait_s: float) -> bool:
        poll = select.poll()
        assert self._writer.stdin is not None
        poll.register(self._writer.stdin, select.POLLOUT)
        return bool(poll.poll(1e3 * wait_s))

    def _last_words(self) -> str:
        """Wait for the writer's end, as long as it does anything; the last line that it said."""
        assert self._writer.stdin is not None
        assert self._writer.stderr is not None
        if self._writer.stderr.closed:
            return self._reason
        size, idle_from = -1, monotonic()
        while self._writer.poll() is None:
            if monotonic() - idle_from > PATIENCE_S:
                return self._give_up(f"has done nothing for {PATIENCE_S:g} s")
            try:
                pushed = self._push() if self._pending else 0
            except BrokenPipeError:
                self._pending.clear()
                pushed = 0
            if self._pending:
                self._takes_more(LOOK_S)
            else:
                with suppress(BrokenPipeError):
                    self._writer.stdin.close()
                with suppress(subprocess.TimeoutExpired):
                    self._writer.wait(LOOK_S)
            grown, size = self._size() != size, self._size()
            if pushed or grown:
                idle_from = monotonic()
        with suppress(BrokenPipeError):
            self._writer.stdin.close()
        os.set_blocking(self._writer.stderr.fileno(), True)
        said = self._writer.stderr.read()
        self._writer.stderr.close()
        lines = [self._reason, *(self._said + said).decode().strip().splitlines()]
        self._reason = lines[-1] or f"the writer ended with {self._writer.returncode}"
        return self._reason

    def _size(self) -> int:
        try:
            return self._path.stat().st_size
        except OSError:
            return 0

    def _give_up(self, why: str) -> str:
        """End a writer that hangs; words about it."""
        assert self._writer.stdin is not None
        assert self._writer.stderr is not None
        self._writer.kill()
        self._writer.wait()
        self._pending.clear()
        for pipe in (self._writer.stdin, self._writer.stderr):
            with suppress(BrokenPipeError):
                pipe.close()
        self._reason = f"the process that writes the log {why} and was ended"
        return self._reason
