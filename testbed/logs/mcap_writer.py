"""The log writer's process: copies frames from a pipe into an MCAP file, until the pipe ends.

    python -m testbed.logs.mcap_writer LOG WARN_BELOW END_BELOW

`recorder.py` starts it. If the flight is killed it lives on until the file is finished. One thread
only empties the pipe, so a slow disk does not affect the flight until 64 MB are queued. Messages go
to stderr, one per line; if the writer fails, its last line is the reason.
"""

import os
import sys
from collections import deque
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from queue import Queue
from threading import Thread

from mcap.data_stream import RecordBuilder
from mcap.records import DataEnd, Footer
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from testbed.core.error import TestbedError
from testbed.core.records.ros import ros_name, schema_text
from testbed.logs.extras import Extras
from testbed.logs.frame_stream import frames_of
from testbed.logs.frames import FULL, READY, Epoch, Frame, Mark, Messages, One, Table, Topic

CHUNK = 1024 * 1024  # a chunk is closed at this size or earlier [bytes]
GULP = 64 * 1024  # most bytes read from the pipe at once
SWITCH_S = 5e-4  # the reading thread gets its turn after this; a full pipe holds up the flight
WAITING = 1024  # most reads queued for the disk
LAST = 0.25  # share of END_BELOW that is kept: rows on their way to a full disk may take the rest


class DiskFullError(TestbedError):
    """The disk has just enough space left to finish the log."""


class File:
    """A new file with atomic flushes: a flush is written completely or not at all."""

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        self._whole, self._pending = 0, bytearray()

    def write(self, data: bytes) -> None:
        """Buffer data for the next flush."""
        self._pending += data

    def tell(self) -> int:
        """Position of the next byte."""
        return self._whole + len(self._pending)

    def flush(self) -> None:
        """Write the buffered data."""
        data, self._pending = bytes(self._pending), bytearray()
        done = 0
        try:
            while done < len(data):
                done += os.write(self._descriptor, data[done:])
        except OSError:
            os.ftruncate(self._descriptor, self._whole)
            os.lseek(self._descriptor, self._whole, os.SEEK_SET)
            raise
        self._whole += done

    def end(self) -> None:
        """Write the shortest valid end of an MCAP file, without a summary."""
        builder = RecordBuilder()
        DataEnd(0).write(builder)
        Footer(0, 0, 0).write(builder)
        self._pending = bytearray(builder.end() + MCAP0_MAGIC)
        self.flush()


def read_chunks(descriptor: int) -> Iterator[bytes]:
    """Data from the pipe, which a thread reads in the background."""
    waiting: Queue[bytes] = Queue(WAITING)

    def drink() -> None:
        while gulp := os.read(descriptor, GULP):
            waiting.put(gulp)
        waiting.put(b"")

    Thread(target=drink, daemon=True).start()
    while gulp := waiting.get():
        yield gulp


class Disk:
    """Watches the free space on the disk."""

    def __init__(self, free: Callable[[], int], warn_below: int, end_below: int) -> None:
        self._free, self._warn_below, self._end_below = free, warn_below, end_below
        self._warned = False
        self.full: DiskFullError | None = None  # why the flight must end

    def check(self, path: Path) -> str | None:
        """A line for the flight, once: a warning, or that it must end.

        Args:
            path: of the log.

        Raises:
            DiskFullError: the flight has not ended in time; the log can still be finished.
        """
        free = self._free()
        if free < self._end_below and self.full is None:
            kept = f"the log ends at {self._end_below / 1e6:.0f} MB"
            why = f"No space left on device: {free / 1e6:.1f} MB are free, {kept}"
            self.full = DiskFullError(why)
            if free >= LAST * self._end_below:
                return f"{FULL}{path}: {why}"
        if self.full is not None:
            if free < LAST * self._end_below:
                raise self.full
            return None
        if free < self._warn_below and not self._warned:
            self._warned = True
            return (
                f"warning: {free / 1e6:.0f} MB left on the disk of the log; "
                f"the run ends at {self._end_below / 1e6:.0f} MB"
            )
        return None


class Log:
    """An MCAP file under way: messages with gapless numbers."""

    def __init__(self, file: File) -> None:
        self.mcap = Writer(file, chunk_size=CHUNK, compression=CompressionType.ZSTD)  # type: ignore[arg-type]
        self.mcap.start(profile="ros2", library="airbearing-testbed")
        self.epoch, self._number = 0, 0  # UTC at time 0 of the run [ns]; of the newest message
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def topic(self, name: str, kind: str) -> int:
        """The channel of a topic."""
        if name not in self._channels:
            if kind not in self._schemas:
                text = schema_text(kind).encode()
                self._schemas[kind] = self.mcap.register_schema(ros_name(kind), "ros2msg", text)
            schema = self._schemas[kind]
            self._channels[name] = self.mcap.register_channel(name, "cdr", schema)
        return self._channels[name]

    def add(self, channel: int, stamp: int, data: bytes) -> None:
        """Append a message of a time of the run [ns]."""
        self._number += 1
        at = self.epoch + stamp
        self.mcap.add_message(channel, at, data, at, self._number)


def write_log(
    path: Path, received: Iterator[Frame], disk: Disk, reply: Callable[[str], object]
) -> None:  # fmt: skip
    """Copy frames into a new file at `path`, never over an older one.

    Raises:
        OSError: it cannot be created, or disk or quota is full; the written part is readable.
        DiskFullError: the disk is nearly full; the file has been finished, with all rows that came
            unless they were too many.
    """
    file = File(path)
    log, extras = Log(file), Extras()
    reply(READY.decode().strip())
    topics: list[tuple[int, Topic]] = []
    try:
        for frame in received:
            match frame:
                case Messages(parts):
                    for one in chain.from_iterable(map(singly, parts)):
                        channel, topic = topics[one.topic]
                        log.add(channel, one.stamp, one.data)
                        for more in extras.of(topic.name, topic.kind, one.stamp, one.data):
                            log.add(log.topic(more.topic, more.kind), one.stamp, more.data)
                case Mark():
                    log.mcap.flush()
                    if line := disk.check(path):
                        reply(line)
                case Epoch(utc_ns):
                    log.epoch = extras.epoch = utc_ns
                case Topic(name, kind):
                    topics.append((log.topic(name, kind), frame))
        finish(log.mcap, file)
        full = disk.full
    except DiskFullError:
        finish(log.mcap, file)
        raise
    except OSError:
        file.end()
        raise
    if full is not None:
        raise full


def singly(part: One | Table) -> Iterator[One]:
    """The messages of a part, in order."""
    if isinstance(part, One):
        yield part
        return
    columns = [chain.from_iterable(stacks) for stacks in part.columns]
    between = deque(part.between)
    for k, (stamp, *row) in enumerate(zip(part.stamps, *columns, strict=True)):
        while between and between[0][0] == k:
            yield between.popleft()[1]
        for topic, data in zip(part.topics, row, strict=True):
            yield One(topic, stamp, bytes(data))
    yield from (one for _, one in between)


def finish(writer: Writer, file: File) -> None:
    """Write the index and the end of the file."""
    writer.finish()
    file.flush()


def free_at(path: Path) -> int:
    """Free space for an ordinary user on the disk of `path` [bytes]."""
    room = os.statvfs(path.parent)
    return room.f_bavail * room.f_frsize


def main() -> int:
    """Write until the pipe ends; on failure returns 1 and prints the reason on stderr."""
    sys.setswitchinterval(SWITCH_S)
    path, (warn_below, end_below) = Path(sys.argv[1]), map(int, sys.argv[2:4])

    def reply(line: str) -> None:
        sys.stderr.write(line + "\n")
        sys.stderr.flush()

    disk = Disk(lambda: free_at(path), warn_below, end_below)
    try:
        write_log(path, frames_of(read_chunks(sys.stdin.fileno())), disk, reply)
    except OSError as error:
        reply(f"{error.filename or path}: {error.strerror}")
    except DiskFullError as error:
        reply(f"{path}: {error}")
    else:
        return 0
    sys.stderr.flush()
    os._exit(1)  # the reading thread may be blocked


if __name__ == "__main__":
    sys.exit(main())
