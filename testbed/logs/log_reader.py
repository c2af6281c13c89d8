"""Reads a log, also while it is written, after its writer was killed, or damaged.

A log is MCAP: records of a byte, a length and a body. Messages are in chunks; the last chunk may be
cut off, and everything before it is complete. The reader keeps its position, so it also follows a
growing file.

The reader skips a damaged part, continues at the next intact chunk and records what is missing.
Topic names in the damaged part are repeated at the end of a finished file.
"""

import os
import struct
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from threading import Event
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from testbed.core.error import TestbedError
from testbed.core.records.definition import OURS as OUR_MESSAGES
from testbed.core.spelling import counted
from testbed.logs.mcap_record import (
    HEAD,
    LARGEST,
    RATIO,
    SKIPPED,
    BrokenError,
    Channel,
    ChunkTooLargeError,
    CutOffError,
    FileSummary,
    Message,
    Record,
    Schema,
    check_index,
    read_chunk,
    read_head,
    read_library,
    read_name,
    read_summary,
    unpacked_size,
)
from testbed.logs.salvage import GiveUpError, Search

OURS = "airbearing-testbed"  # library name of logs with gapless message numbers
_TIME = struct.Struct("<d")
LOOK_S = 0.04  # between two looks for a log that is not there yet
SAID = 10  # places of damage that are listed one by one
KINDS = {  # kind of a topic whose schema is lost, by the last part of its name
    "tick": "Tick", "ending": "Tick", "host": "HostTick", "valves": "Valves", "pace": "Pace",
    "loop": "Loop", "supervisor": "Event", "event": "Event", "truth": "Truth", "names": "Names",
    "formation": "Formation",
}  # fmt: skip
UNREADABLE = (ValueError, RecursionError, OverflowError)  # raised by an invalid message


class LogError(TestbedError):
    """The log is missing, or the file is not a log."""


class Row(NamedTuple):
    """One message as stored in the file."""

    topic: str
    stamp: int  # time of the run [ns]; UTC in a log that is not of this software
    data: bytes  # CDR


class Damage(NamedTuple):
    """A damaged place in a log, and what is missing there."""

    at: int  # offset in the file [bytes]
    messages: int | None  # number of missing messages; None: not known
    since: float | None  # time of the last message before [s]; None: no message
    until: float | None  # time of the first message after, or of the log's end [s]; None: not known

    def __str__(self) -> str:
        place = f"damaged at byte {self.at}"
        if self.messages == 0:
            return f"{place}: nothing of the flight is missing"
        begin = 0.0 if self.since is None else self.since
        if self.until is None:
            what = "the flight" if self.since is None else f"the flight after {begin:.2f} s"
            return f"{place}: {what} is missing"
        words = f"{place}: {max(0.0, self.until - begin):.2f} s of flight ({begin:.2f} s to "
        lost = "" if self.messages is None else f", {counted(self.messages, 'message')}"
        return f"{words}{self.until:.2f} s) are missing{lost}"


class LogReader:
    """Reads a log from its beginning.

    Raises:
        LogError: the file is missing, is not a log, or unpacks to too much data.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.finished = False  # the file has a proper end, which was read
        self.cut_off = False  # all was read, and the file ends early without damage
        self.kinds: dict[str, str] = {}  # topic -> name of its messages
        self.texts: dict[str, str] = {}  # topic -> text of its schema
        self._epoch: int | None = None  # UTC at time 0 of the run [ns]
        self.damages: list[Damage] = []  # skipped so far
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._nameless = 0  # messages of topics whose names are lost
        self._at = self._sound = len(MCAP0_MAGIC)  # next record; end of the last intact chunk
        self._gap = self._at  # end of the intact chunk before that
        self._hurt: int | None = None  # damage skipped since the last message
        self._stuck: int | None = None  # damage with no intact chunk after it
        self._looked_at = -1  # size of the file at the last search without result [bytes]
        self._ours = True
        self._sequence = 0  # of the last message
        self._stamp: int | None = None  # of the last message [ns]
        self._unpacked = 0  # unpacked so far [bytes]
        self._search = Search()
        try:
            with path.open("rb") as file:
                magic = file.read(len(MCAP0_MAGIC))
                if not MCAP0_MAGIC.startswith(magic):
                    self._without_beginning(file, magic)
        except OSError as error:
            raise LogError(f"{path}: {error.strerror}") from None

    def _without_beginning(self, file: BinaryIO, magic: bytes) -> None:
        """Handle wrong first bytes: not a log, or its beginning is damaged."""
        self._at = self._sound = 0
        if self._search_on(file, _size(file)) is None:
            found = f"a file that begins with {magic.decode('latin-1')!r}"
            raise LogError(where=str(self.path), expected="an MCAP file", found=found)
        self._at = self._sound = self._unpacked = 0

    def read(self) -> Iterator[Row]:
        """Every message that has been written since the last call, in the order of writing.

        Raises:
            LogError: it unpacks to too much data, or is too damaged to search.
        """
        with self.path.open("rb") as file:
            while not self.finished:
                records = self._step(file)
                if records is None:
                    self.cut_off = self._stuck is None
                    return
                self.cut_off = False
                yield from self._rows(file, records)

    @property
    def lost(self) -> bool:
        """Whether messages are missing in the part read so far or right after it."""
        return bool(self._nameless) or any(one.messages != 0 for one in self._places())

    def complete(self) -> bool:
        """Whether every message has been read and the file has a proper end."""
        with self.path.open("rb") as file:
            return self.finished and not self.lost and read_summary(file) is not None

    @property
    def epoch(self) -> int:
        """UTC at time 0 of the run, as far as it is known [ns]."""
        return self._epoch or 0

    @property
    def last_s(self) -> float | None:
        """Time of the run of the last message so far; None: no message [s]."""
        return self._seconds(self._stamp)

    def missing(self) -> list[str]:
        """Messages about damage in the part read so far or right after it; empty: none."""
        places = [*self._places(), *self._hurt_end()]
        lines = [f"{self.path} is {one}" for one in places[:SAID]]
        if len(places) > SAID:
            lines.append(f"{self.path} is damaged in {len(places) - SAID} more places")
        if self._nameless:
            lines.append(
                f"{self.path}: {self._nameless} messages are missing, "
                "because the names of their topics are in a damaged part"
            )
        return lines

    def _places(self) -> list[Damage]:
        if self._stuck is None:
            return self.damages
        return [*self.damages, Damage(self._stuck, None, self._seconds(self._stamp), None)]

    def _hurt_end(self) -> list[Damage]:
        """Damage after the last message of a finished file."""
        if not self.finished or self.lost:
            return []
        with self.path.open("rb") as file:
            whole = read_summary(file) is not None
        return [] if whole else [Damage(self._at, 0, self.last_s, self.last_s)]

    def _step(self, file: BinaryIO) -> list[Record] | None:
        """Contents of the next record; None at the current end of the file."""
        size = _size(file)
        if self._at >= size or size == self._looked_at:
            return None
        try:
            opcode, length = read_head(file, self._at, size)
            if opcode in SKIPPED:
                self._at += HEAD.size + length
                return []
            records = self._body(file, opcode, file.read(length), size)
        except CutOffError:
            return self._resume(file, size, is_damage=False)
        except BrokenError:
            return self._resume(file, size, is_damage=True)
        self._at += HEAD.size + length
        if opcode == Opcode.CHUNK:
            self._gap, self._sound = self._sound, self._at
        return records

    def _body(self, file: BinaryIO, opcode: int, body: bytes, size: int) -> list[Record]:
        match opcode:
            case Opcode.CHUNK:
                return self._chunk(body, size)
            case Opcode.SCHEMA | Opcode.CHANNEL:
                return [read_name(opcode, body)]
            case Opcode.HEADER:
                self._ours = read_library(body) == OURS
            case Opcode.MESSAGE_INDEX:
                check_index(body)
            case Opcode.DATA_END:
                if len(body) != 4:
                    raise BrokenError("no end of the data")
                self.finished = True
                self._ended(file)
        return []

    def _chunk(self, body: bytes, size: int) -> list[Record]:
        try:
            records = read_chunk(body, self._allowance(size))
        except ChunkTooLargeError as error:
            raise self._refused(error) from None
        self._unpacked += unpacked_size(body)
        return records

    def _allowance(self, size: int) -> int:
        """How much the rest of the file may unpack to [bytes]."""
        return LARGEST + RATIO * size - self._unpacked

    def _refused(self, error: ChunkTooLargeError) -> LogError:
        return LogError(
            where=str(self.path), found=f"{error} bytes",
            expected=f"chunks of at most {LARGEST >> 20} MB, and a log of at most {RATIO} times "
            "the size of its file",
        )  # fmt: skip

    def _resume(self, file: BinaryIO, size: int, *, is_damage: bool) -> list[Record] | None:
        """Continue at the next intact chunk, or at the proper end of the file."""
        stopped = self._at
        if (found := self._search_on(file, size)) is not None:
            self._hurt = stopped if self._hurt is None else self._hurt
            return found
        if read_summary(file) is not None:
            self._hurt = stopped if self._hurt is None else self._hurt
            self.finished = True
            self._ended(file)
            return []
        self._looked_at = size
        self._stuck = stopped if is_damage else None
        return None

    def _search_on(self, file: BinaryIO, size: int) -> list[Record] | None:
        try:
            found = self._search.next_chunk(file, self._sound, size, self._allowance(size))
        except ChunkTooLargeError as error:
            raise self._refused(error) from None
        except GiveUpError:
            raise LogError(
                f"{self.path}: damaged at byte {self._at}, and too much after it looks like a log"
            ) from None
        if found is None:
            return None
        self._gap, self._at, self._sound, self._stuck = self._sound, found.end, found.end, None
        self._unpacked += found.unpacked
        return found.records

    def _ended(self, file: BinaryIO) -> None:
        """Record what is missing since the last message, from the file's own count."""
        if self._hurt is None:
            return
        summary = self._repeated(file)
        for name in summary.records:
            self._learn(name)
        missing = None
        if self._ours and summary.messages is not None:
            missing = max(0, summary.messages - self._sequence)
        until = self._seconds(summary.last)
        self.damages.append(Damage(self._hurt, missing, self._seconds(self._stamp), until))
        self._hurt = None

    def _repeated(self, file: BinaryIO) -> FileSummary:
        return read_summary(file) or FileSummary([])

    def _rows(self, file: BinaryIO, records: list[Record]) -> Iterator[Row]:
        if self._epoch is None:
            for name in records:
                if not isinstance(name, Message):
                    self._learn(name)
            if any(isinstance(r, Message) and r.channel not in self._channels for r in records):
                for name in self._repeated(file).records:
                    self._learn(name)
            self._epoch = self._zero(records)
        epoch, channels = self.epoch, self._channels
        for record in records:
            if not isinstance(record, Message):
                self._learn(record)
                continue
            number, sequence, stamp, data = record
            if self._hurt is not None or sequence != self._sequence + 1:
                self._account(record)
            self._sequence, self._stamp = sequence, stamp
            channel = channels.get(number)
            if channel is None and not self._nameless:
                for name in self._repeated(file).records:
                    self._learn(name)
                channel = channels.get(number)
            if channel is None:
                self._nameless += 1
                continue
            yield Row(channel.topic, stamp - epoch, data)

    def _zero(self, records: list[Record]) -> int | None:
        """UTC at time 0 of the run, from a row: it begins with its time of the run."""
        for one in records:
            if isinstance(one, Message) and self._is_ours(self._channels.get(one.channel)):
                with suppress(struct.error, ValueError, OverflowError):
                    return one.stamp - round(1e9 * _TIME.unpack_from(one.data, 4)[0])
        return None

    def _is_ours(self, channel: Channel | None) -> bool:
        """Whether the messages of a channel are of this software."""
        schema = None if channel is None else self._schemas.get(channel.schema)
        if schema is None:
            return channel is not None and self._ours and bool(self.kinds[channel.topic])
        return schema.name.startswith(f"{OUR_MESSAGES}/")

    def _learn(self, name: Schema | Channel) -> None:
        if isinstance(name, Schema):
            self._schemas[name.number] = name
            return
        self._channels[name.number] = name
        schema = self._schemas.get(name.schema)
        kind = KINDS.get(name.topic.rpartition("/")[2], "") if schema is None else schema.name
        self.kinds[name.topic] = kind.replace("/msg/", "/").removeprefix(f"{OUR_MESSAGES}/")
        self.texts[name.topic] = "" if schema is None else schema.text

    def _seconds(self, stamp: int | None) -> float | None:
        """Time of the run [s]."""
        return None if stamp is None else (stamp - self.epoch) * 1e-9

    def _account(self, message: Message) -> None:
        """Record what is missing before a message."""
        missing = max(0, message.sequence - self._sequence - 1) if self._ours else None
        if self._hurt is not None or missing:
            at = self._gap if self._hurt is None else self._hurt
            now = self._seconds(message.stamp)
            self.damages.append(Damage(at, missing, self._seconds(self._stamp), now))
            self._hurt = None
        self._sequence, self._stamp = message.sequence, message.stamp


def _size(file: BinaryIO) -> int:
    return file.seek(0, os.SEEK_END)


def config_of(run: Path) -> Path:
    """The experiment file of a run folder, or of a log in a run folder."""
    return (run if run.is_dir() else run.parent) / "config.toml"


def log_of(run: Path) -> Path:
    """The log, given a run folder or the log itself.

    Raises:
        LogError: it is not a run folder.
    """
    if not run.is_dir():
        return run
    if not any((run / name).exists() for name in ("log.mcap", "config.toml")):
        raise LogError(
            where=str(run), found="neither",
            expected="a run folder, with a log.mcap and a config.toml in it",
        )  # fmt: skip
    return run / "log.mcap"


def await_log(path: Path) -> LogReader:
    """A run's log, as soon as its writer has created it."""
    pause = Event()
    while not (path.exists() and path.stat().st_size > len(MCAP0_MAGIC)):
        pause.wait(LOOK_S)
    return LogReader(path)
