"""The recorder's own process: frames from a pipe into an MCAP file, until the pipe ends.

    python -m testbed.logs.mcap_writer LOG WARN_BELOW END_BELOW

It is started by `recorder.py` and outlives whatever happens to the flight by the time it takes to
finish the file. One thread does nothing but empty the pipe, so a slow disk is not the flight's
trouble until some 64 MB wait. What it has to say goes to stderr, one line each; the last line of a
writer that gave up is the reason.
"""

import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import Queue
from threading import Thread

import msgspec
from mcap.data_stream import RecordBuilder
from mcap.records import DataEnd, Footer
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from testbed.core.error import TestbedError
from testbed.logs.recorder import READY, Entry, Frame, Mark, Topic

CHUNK = 256 * 1024  # [bytes] a chunk is closed at this size, however little time it spans
GULP = 64 * 1024  # [bytes] read from the pipe at once, at most
WAITING = 1024  # gulps that may wait for the disk


class DiskFullError(TestbedError):
    """There is just enough room left to end the log properly."""


class File:
    """A new file that is written in whole pieces: what is flushed is there, or none of it is."""

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        self._whole, self._pending = 0, bytearray()

    def write(self, data: bytes) -> None:
        """Remember for the next flush."""
        self._pending += data

    def tell(self) -> int:
        """Where the next byte goes."""
        return self._whole + len(self._pending)

    def flush(self) -> None:
        """Write what is remembered."""
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
        """The shortest proper end of an MCAP file, without a summary."""
        builder = RecordBuilder()
        DataEnd(0).write(builder)
        Footer(0, 0, 0).write(builder)
        self._pending = bytearray(builder.end() + MCAP0_MAGIC)
        self.flush()


def gulps(descriptor: int) -> Iterator[bytes]:
    """What comes through the pipe; a thread empties it meanwhile."""
    waiting: Queue[bytes] = Queue(WAITING)

    def drink() -> None:
        while gulp := os.read(descriptor, GULP):
            waiting.put(gulp)
        waiting.put(b"")

    Thread(target=drink, daemon=True).start()
    while gulp := waiting.get():
        yield gulp


def frames(pieces: Iterator[bytes]) -> Iterator[Frame]:
    """Frames of a stream; one that is cut off at the end was never sent."""
    decode = msgspec.msgpack.Decoder(Frame).decode
    rest = b""
    for piece in pieces:
        data, at = rest + piece, 0
        while len(data) - at >= 4:
            end = at + 4 + int.from_bytes(data[at : at + 4], "little")
            if end > len(data):
                break
            yield decode(data[at + 4 : end])
            at = end
        rest = data[at:]


class Disk:
    """How much room there is, and what to say about it."""

    def __init__(self, free: Callable[[], int], warn_below: int, end_below: int) -> None:
        self._free, self._warn_below, self._end_below = free, warn_below, end_below
        self._warned = False

    def check(self) -> str | None:
        """A warning, once; before it is too late, DiskFullError."""
        free = self._free()
        if free < self._end_below:
            raise DiskFullError(f"No space left on device: {free / 1e6:.0f} MB")
        if free < self._warn_below and not self._warned:
            self._warned = True
            return (
                f"warning: {free / 1e6:.0f} MB left on the disk of the log; "
                f"the run ends at {self._end_below / 1e6:.0f} MB"
            )
        return None


def write_log(
    path: Path, received: Iterator[Frame], disk: Disk, say: Callable[[str], object]
) -> None:
    """Copy frames into a new file at `path`, never over an older one.

    Raises:
        OSError: it cannot be made, or the disk is full or quota reached; what is there is whole.
        DiskFullError: it was ended properly while there was room.
    """
    file = File(path)
    writer = Writer(file, chunk_size=CHUNK, compression=CompressionType.ZSTD)  # type: ignore[arg-type]
    say(READY.decode().strip())
    writer.start(profile="", library="airbearing-testbed")
    channels: list[int] = []
    schemas: dict[tuple[str, bytes], int] = {}  # each once: vehicles share them
    sequence = 0
    try:
        for frame in received:
            match frame:
                case Entry(topic, stamp, data):
                    sequence += 1
                    writer.add_message(channels[topic], stamp, data, stamp, sequence)
                case Mark():
                    writer.flush()
                    if warning := disk.check():
                        say(warning)
                case Topic(name, schema_name, schema):
                    number = schemas.get((schema_name, schema), 0)
                    if not number:
                        number = writer.register_schema(schema_name, "jsonschema", schema)
                        schemas[schema_name, schema] = number
                    channels.append(writer.register_channel(name, "json", number))
        finish(writer, file)
    except DiskFullError:
        finish(writer, file)
        raise
    except OSError:
        file.end()
        raise


def finish(writer: Writer, file: File) -> None:
    """Index and end."""
    writer.finish()
    file.flush()


def free_at(path: Path) -> int:
    """Room for an ordinary user on the disk of `path` [bytes]."""
    room = os.statvfs(path.parent)
    return room.f_bavail * room.f_frsize


def main() -> int:
    """Write until the pipe ends; 1 and a line on stderr if that is impossible."""
    path, warn_below, end_below = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])

    def say(line: str) -> None:
        sys.stderr.write(line + "\n")
        sys.stderr.flush()

    disk = Disk(lambda: free_at(path), warn_below, end_below)
    try:
        write_log(path, frames(gulps(sys.stdin.fileno())), disk, say)
    except OSError as error:
        say(f"{error.filename or path}: {error.strerror}")
    except DiskFullError as error:
        say(f"{path}: {error}")
    else:
        return 0
    sys.stderr.flush()
    os._exit(1)  # the thread may be in the middle of reading


if __name__ == "__main__":
    sys.exit(main())
