"""Records every tick's inputs and outputs in one MCAP file, the log of the run.

    /<vehicle>/tick    one tick of the flight chain: inputs and outputs
    /<vehicle>/ending  the same after the end of the flight, until its air is off
    /<vehicle>/host    one tick of its law, if the law runs on the host
    /<vehicle>/event   texts that its rows refer to: faults, exceptions
    /<vehicle>/valves  valve outputs of its board, with firmware in the loop
    /<vehicle>/pace    timing of its ticks and state of its connections, on real wires
    /loop              timing of the host's loop, in real time
    /supervisor        phase changes of the supervisor, and their reasons
    /truth             true poses of the vehicles; only from a twin
    /names             names that rows refer to by number

Messages are records of `core/records`, as CDR with their ros2msg schemas: ROS 2, Foxglove and
PlotJuggler read them. `extras.py` adds standard messages for what people plot. A row has the time
of the run; the time of the log is UTC, from the time of the run plus `epoch_ns`. So the same seed
and epoch give the same bytes.

A separate process (`mcap_writer.py`) writes the file from a pipe: the flight does not wait for the
disk, and if the flight is killed the writer still finishes the file. A chunk of the file is closed
every `span_ns` of the run, so a killed writer loses at most that and the data in the pipe.

On real wires the flight never waits for the pipe, because it would lose its vehicles: data that the
pipe does not take is kept in memory, and beyond LARGEST_BACKLOG rows are lost with a warning. On
the twin, which is faster than a disk, the flight waits for the writer, unless the writer hangs.
"""

import os
import select
import struct
import subprocess
import sys
from bisect import bisect_left
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from time import monotonic
from types import TracebackType

from msgspec import Struct

from testbed.core.error import TestbedError
from testbed.flight.flown_span import FlownSpan
from testbed.flight.flown_tick import FlownHostTick, FlownTick
from testbed.logs.block import LARGEST, Block, Columns, Later, Piece, nothing
from testbed.logs.frame_stream import pieces_of
from testbed.logs.frames import FULL, READY, Epoch, Frame, Mark, Messages, One, Table, Topic
from testbed.logs.outbox import Outbox, widen
from testbed.logs.tick_row import Made, Names, RowWriter

BUFFER = 256 * 1024  # size of the pipe [bytes]; a third of a second of messages
FAST_BUFFER = 1024 * 1024  # the same faster than real time; the most that Linux gives a user
PIECE = 64 * 1024  # most bytes kept between two marks before they are written
LEAD = 4_000_000  # most bytes that a fast flight is ahead of its writer: 50 s of three vehicles
LARGEST_BACKLOG = 32_000_000  # most bytes kept in memory for a slow writer
LOOK_S = 0.05
PATIENCE_S = 5.0  # a writer without progress for this long hangs
SPAN_NS = 50_000_000  # time of the run per chunk; the same run gives the same chunks
FAST_SPAN_NS = 25_000_000_000  # the same faster than real time: larger chunks compress better
CAREFUL_SPAN_NS = 5_000_000_000  # the same with a user's law, which may end the process
WARN_BELOW = 500_000_000  # free disk space below which to warn [bytes]
END_BELOW = 20_000_000  # free disk space below which to finish the log [bytes]

SCENE = "visualization_msgs/MarkerArray"


class RecorderError(TestbedError):
    """The log cannot be written, for instance because the disk is full."""


class Recorder:
    """Writes a log; a context manager that finishes the file after any end of the flight.

    Args:
        path: of the new file.
        names: that rows refer to by number.
        waits: wait for a slow writer; otherwise rows are lost.
        warn_below, end_below: limits of free disk space [bytes].
        span_ns: time of the run per chunk, which ends with the last tick in it.
        tick_ns: from one tick to the next.
        epoch_ns: time of the log, UTC, at time 0 of the run; may be set later, see `epoch_ns`.
        scene: a MarkerArray to begin with, see extras.py; empty: none.

    Raises:
        RecorderError: on writing or leaving, if the writer failed.
    """

    def __init__(
        self,
        path: Path,
        warn_below: int = WARN_BELOW,
        end_below: int = END_BELOW,
        names: Names | None = None,
        *,
        waits: bool = True,
        span_ns: int = SPAN_NS,
        tick_ns: int = 0,
        epoch_ns: int = 0,
        scene: bytes = b"",
    ) -> None:
        self._path, self._waits = path, waits
        self.lost = 0  # rows
        self.epoch_ns = epoch_ns  # counts until the first row
        self._reported = False  # whether lost rows have been reported
        self._pending = Outbox()
        self._command = [
            *(sys.executable, "-m", "testbed.logs.mcap_writer"),
            *(str(path), str(warn_below), str(end_below)),
        ]
        self._span, self._tick = span_ns, tick_ns
        self._begins: int | None = None  # from where the chunk's span counts [ns]
        self._met = False  # the writer has created the file
        self._unread = b""  # output of the writer that has not been passed on
        self._reason = ""  # the writer's newest line
        self._topics: dict[str, int] = {}
        self._rows, self._scene = RowWriter(names), scene
        self._block, self._fast = Block(self._rows), span_ns > SPAN_NS
        far = span_ns >= FAST_SPAN_NS
        self._lead, self._buffer = (LEAD, FAST_BUFFER) if far else (BUFFER, BUFFER)

    def __enter__(self) -> "Recorder":
        self._writer = subprocess.Popen(
            self._command,
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            start_new_session=True,  # no Ctrl-C: the writer ends when the pipe closes
        )
        widen(self._writer.stdin, self._buffer)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with suppress(RecorderError):  # its reason is printed below
            if self._block:
                self._append(self._block.take())
        reason = self._last_words()
        if self._writer.returncode != 0 and kind is None:
            raise RecorderError(reason)

    def write(self, topic: str, t: float, message: Struct | FlownTick | FlownHostTick) -> None:
        """Append one message of time `t` [s] to `topic`.

        Raises:
            RecorderError: the writer failed, or a number does not fit its field.
        """
        if isinstance(message, FlownTick | FlownHostTick):
            if self._fast:
                if not self._met:
                    self.wait_for_writer()
                for one in self._rows.before(topic, t, message.fault):
                    self._block.add(t, one.topic, one)
                self._block.add(t, topic, message)
                return
            message = message.tick
        try:
            rows = self._rows.rows(topic, t, message)
        except (struct.error, OverflowError) as error:
            raise RecorderError(f"a message of {topic} at {t:.3f} s: {error}") from None
        if self._scene:
            rows.append(Made("/scene", SCENE, self._scene))
            self._scene = b""
        for one in rows:
            self.append(one.topic, one.kind, t, one.data)

    def write_span(self, span: FlownSpan, topic: str = "", later: Later = nothing) -> None:
        """Append ticks, the truth after each, and a message of `topic` after some.

        Args:
            span: the ticks.
            topic: of the messages that `later` gives.
            later: gives messages by time of the tick [s]; called when the rows are made.

        Raises:
            RecorderError: see `write`.
        """
        if not self._met:
            self.wait_for_writer()
        self._block.add_span(span, topic, later)

    def due_in(self, times: Sequence[float]) -> int:
        """How many of the ticks at these times come until the next `mark`."""
        last = bisect_left(times, True, key=lambda t: self._ends(round(t * 1e9)))
        return min(1 + last, len(times))

    def _ends(self, now: int) -> bool:
        """Whether the chunk ends with the tick at this time [ns]; the first tick has its own."""
        return self._begins is None or now + self._tick - self._begins >= self._span

    def append(self, topic: str, kind: str, t: float, data: bytes) -> None:
        """Append the bytes of one message of a kind of `core/records`."""
        made = Made(topic, kind, data)
        if self._block:
            self._block.add(t, topic, made)
        else:
            self._append([(t, made)])

    def _append(self, pieces: Sequence[Piece]) -> None:
        if not self._met:
            self.wait_for_writer()
        self._send(Messages([self._part(piece) for piece in pieces]))

    def _part(self, piece: Piece) -> One | Table:
        if not isinstance(piece, Columns):
            return self._one(*piece)
        numbers = [self._number(one.topic, one.kind) for one in piece.columns]
        stamps = [round(t * 1e9) for t in piece.times]
        between = [(k, self._one(t, made)) for k, t, made in piece.between]
        return Table(numbers, stamps, [one.stacks for one in piece.columns], between)

    def _one(self, t: float, made: Made) -> One:
        return One(self._number(made.topic, made.kind), round(t * 1e9), made.data)

    def _number(self, topic: str, kind: str) -> int:
        """The number of a topic, of which the writer is told when it is new."""
        number = self._topics.get(topic)
        if number is None:
            if not self._topics:
                self._send(Epoch(self.epoch_ns))
            number = self._topics[topic] = len(self._topics)
            self._send(Topic(topic, kind))
        return number

    def wait_for_writer(self) -> None:
        """Wait until the writer has created the file; from then on a kill loses little.

        Raises:
            RecorderError: it cannot.
        """
        self._raise_if_ended()
        assert self._writer.stdin is not None
        assert self._writer.stderr is not None
        if not select.select([self._writer.stderr], [], [], 4.0 * PATIENCE_S)[0]:
            raise RecorderError(self._give_up("did not start"))
        self._unread = self._writer.stderr.readline()
        if self._unread != READY:
            raise RecorderError(self._last_words())
        self._met, self._unread = True, b""
        os.set_blocking(self._writer.stderr.fileno(), False)
        os.set_blocking(self._writer.stdin.fileno(), False)

    def mark(self, t: float) -> list[str]:
        """Pass a complete tick to the writer; returns its messages, for instance about the disk.

        Raises:
            RecorderError: the writer has ended, or the disk is nearly full.
        """
        now = round(t * 1e9)
        due = self._ends(now)
        if self._fast and not due and len(self._block) < LARGEST:
            if self._pending.size:
                self._hand_over()
            return []  # faster than real time, a write per tick costs more than rows
        if self._block:
            self._append(self._block.take())
        if due:
            self._begins = now if self._begins is None else now + self._tick
            self._send(Mark())
        self._hand_over()
        assert self._writer.stderr is not None
        try:
            received = os.read(self._writer.stderr.fileno(), 4096)
        except BlockingIOError:
            return self._losses()  # no messages
        if not received:
            raise RecorderError(self._last_words())
        *lines, self._unread = (self._unread + received).split(b"\n")
        self._reason = lines[-1].decode() if lines else self._reason
        if self._reason.startswith(FULL):  # the writer goes on until this flight has ended
            raise RecorderError(self._reason.removeprefix(FULL))
        warnings = [line.decode() for line in lines if line.startswith(b"warning")]
        return warnings + self._losses()

    def _losses(self) -> list[str]:
        """A warning about lost rows, once."""
        if not self.lost or self._reported:
            return []
        self._reported = True
        return ["warning: the process that writes the log does not keep up; rows of it are lost"]

    def _send(self, frame: Frame) -> None:
        if self._pending.size > LARGEST_BACKLOG and not isinstance(frame, Topic):
            self.lost += len(frame) if isinstance(frame, Messages) else 0
            return
        for piece in pieces_of(frame):
            if isinstance(piece, memoryview):
                self._pending.add_memory(piece)
            else:
                self._pending.add(piece)
        if self._pending.size >= PIECE:
            self._hand_over()

    def _hand_over(self) -> None:
        """Write to the pipe; on the twin, wait until it takes more.

        Raises:
            RecorderError: the writer has ended or hangs.
        """
        self._raise_if_ended()
        try:
            self._push()
            while self._waits and self._pending.size > self._lead:
                if not self._takes_more(PATIENCE_S):
                    raise RecorderError(self._give_up(f"took nothing for {PATIENCE_S:g} s"))
                self._push()
        except BrokenPipeError:
            self._pending.clear()
            raise RecorderError(self._last_words()) from None

    def _raise_if_ended(self) -> None:
        """Raise the reason again, if the writer has ended and its last words were read."""
        assert self._writer.stdin is not None
        if self._writer.stdin.closed:
            self._pending.clear()
            raise RecorderError(self._reason)

    def _push(self) -> int:
        """Write without waiting; returns the number of bytes."""
        assert self._writer.stdin is not None
        return self._pending.write_to(self._writer.stdin.fileno())

    def _takes_more(self, wait_s: float) -> bool:
        poll = select.poll()
        assert self._writer.stdin is not None
        poll.register(self._writer.stdin, select.POLLOUT)
        return bool(poll.poll(1e3 * wait_s))

    def _last_words(self) -> str:
        """Wait for the writer to end while it makes progress; returns its last line."""
        assert self._writer.stdin is not None
        assert self._writer.stderr is not None
        if self._writer.stderr.closed:
            return self._reason
        size, idle_from = -1, monotonic()
        while self._writer.poll() is None:
            if monotonic() - idle_from > PATIENCE_S:
                return self._give_up(f"did nothing for {PATIENCE_S:g} s")
            try:
                pushed = self._push() if self._pending.size else 0
            except BrokenPipeError:
                self._pending.clear()
                pushed = 0
            if self._pending.size:
                self._takes_more(LOOK_S)
            else:
                with suppress(BrokenPipeError):
                    self._writer.stdin.close()
                with suppress(subprocess.TimeoutExpired):
                    self._writer.wait(LOOK_S)
            before, size = size, self._size()
            if pushed or size != before:
                idle_from = monotonic()
        with suppress(BrokenPipeError):
            self._writer.stdin.close()
        os.set_blocking(self._writer.stderr.fileno(), True)
        rest = self._writer.stderr.read()
        self._writer.stderr.close()
        lines = [self._reason, *(self._unread + rest).decode().strip().splitlines()]
        self._reason = lines[-1] or f"the log writer ended with {self._writer.returncode}"
        return self._reason

    def _size(self) -> int:
        try:
            return self._path.stat().st_size
        except OSError:
            return 0

    def _give_up(self, why: str) -> str:
        """Kill a writer that hangs; returns the reason."""
        assert self._writer.stdin is not None
        assert self._writer.stderr is not None
        self._writer.kill()
        self._writer.wait()
        self._pending.clear()
        for pipe in (self._writer.stdin, self._writer.stderr):
            with suppress(BrokenPipeError):
                pipe.close()
        self._reason = f"the process that writes the log {why} and was killed"
        return self._reason
