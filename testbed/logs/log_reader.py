"""Reading a log of record, also while it is being written, after its writer was killed, or damaged.

A log is MCAP: records of a byte, a length and a body. Messages are in chunks; the last chunk may be
cut off, and everything before it is whole. The reader remembers how far it got, so the same one
serves a finished file and one that grows.

A damaged part is passed over: the reader goes on at the next whole chunk and remembers what is
missing. Names of topics that were in the damaged part are repeated at the end of a finished file.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from testbed.core.error import TestbedError
from testbed.logs.mcap_record import (
    HEAD,
    LARGEST,
    RATIO,
    SKIPPED,
    BombError,
    BrokenError,
    Channel,
    CutOffError,
    Message,
    Record,
    Schema,
    Summary,
    check_index,
    read_chunk,
    read_head,
    read_library,
    read_name,
    read_summary,
    unpacked_size,
)
from testbed.logs.salvage import GiveUpError, Search

OURS = "airbearing-testbed"  # the library of a log whose messages are numbered without a gap
SAID = 10  # places of damage that are said one by one
KINDS = {  # of a topic whose schema is lost, by the last part of its name
    "tick": "Tick", "host": "HostTick", "valves": "Valves", "pace": "Pace", "loop": "Loop",
    "supervisor": "Event", "truth": "Truth", "formation": "Characterisation",
}  # fmt: skip
UNREADABLE = (ValueError, RecursionError, OverflowError)  # what a message that is none raises


class LogError(TestbedError):
    """It is not there, or it is not a log."""


class Row(NamedTuple):
    """One message as it lies in the file."""

    topic: str
    stamp: int  # time of the run [ns]
    data: bytes  # JSON


class Damage(NamedTuple):
    """A place at which a log is damaged, and what is missing there."""

    at: int  # byte
    messages: int | None  # that are missing; None: not known
    since: float | None  # last message before [s]; None: there is none
    until: float | None  # first message after, or the last of all [s]; None: not known

    def __str__(self) -> str:
        place = f"damaged at byte {self.at}"
        if self.messages == 0:
            return f"{place}: nothing of the flight is missing"
        begin = 0.0 if self.since is None else self.since
        if self.until is None:
            what = "the flight" if self.since is None else f"all that was flown after {begin:.2f} s"
            return f"{place}: {what} is missing"
        said = f"{place}: {max(0.0, self.until - begin):.2f} s of flight ({begin:.2f} s to "
        counted = (
            ""
            if self.messages is None
            else f", {self.messages} message{'s' * (self.messages != 1)}"
        )
        return f"{said}{self.until:.2f} s) are missing{counted}"


class LogReader:
    """A log, read from the beginning on.

    Raises:
        LogError: there is no file, it is something else, or it unpacks to far too much.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.finished = False  # it was ended properly, and the end was read
        self.kinds: dict[str, str] = {}  # topic -> name of its schema
        self.damages: list[Damage] = []  # passed over so far
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, Channel] = {}
        self._nameless = 0  # messages of topics whose names are lost
        self._at = self._sound = len(MCAP0_MAGIC)  # next record; end of the last whole chunk
        self._gap = self._at  # end of the whole chunk before that
        self._hurt: int | None = None  # damage that was passed over since the last message
        self._stuck: int | None = None  # damage behind which nothing whole was found
        self._looked_at = -1  # [bytes] size of the file when nothing was found
        self._ours = True
        self._sequence = 0  # of the last message
        self._stamp: int | None = None  # of the last message [ns]
        self._unpacked = 0  # [bytes] so far
        self._search = Search()
        try:
            with path.open("rb") as file:
                magic = file.read(len(MCAP0_MAGIC))
                if not MCAP0_MAGIC.startswith(magic):
                    self._without_beginning(file, magic)
        except OSError as error:
            raise LogError(f"{path}: {error.strerror}") from None

    def _without_beginning(self, file: BinaryIO, magic: bytes) -> None:
        """The first bytes are wrong: it is no log, or its beginning is damaged."""
        self._at = self._sound = 0
        if self._search_on(file, _size(file)) is None:
            raise LogError(where=str(self.path), expected="an MCAP file", found=repr(magic))
        self._at = self._sound = self._unpacked = 0

    def read(self) -> Iterator[Row]:
        """Every message that has been written since the last call, in the order of writing.

        Raises:
            LogError: it unpacks to far too much, or is damaged beyond searching.
        """
        with self.path.open("rb") as file:
            while not self.finished:
                records = self._step(file)
                if records is None:
                    return
                yield from self._rows(file, records)

    @property
    def lost(self) -> bool:
        """Whether messages are missing in what was read so far, or behind it."""
        return bool(self._nameless) or any(one.messages != 0 for one in self._places())

    def complete(self) -> bool:
        """Whether all that was ever written has been read, and the file has its proper end."""
        with self.path.open("rb") as file:
            return self.finished and not self.lost and read_summary(file) is not None

    def said(self) -> list[str]:
        """The damage in what was read so far and behind it, in words; empty: none."""
        places = self._places()
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
        return [*self.damages, Damage(self._stuck, None, _seconds(self._stamp), None)]

    def _step(self, file: BinaryIO) -> list[Record] | None:
        """What the next record holds; None at the end of what is there."""
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
        except BombError as error:
            raise self._refused(error) from None
        self._unpacked += unpacked_size(body)
        return records

    def _allowance(self, size: int) -> int:
        """What the rest of the file may unpack to [bytes]."""
        return LARGEST + RATIO * size - self._unpacked

    def _refused(self, error: BombError) -> LogError:
        return LogError(
            f"{self.path}\n  expected  chunks of at most {LARGEST >> 20} MB, and a log of at most "
            f"{RATIO} times the size of its file\n  found     {error} bytes"
        )

    def _resume(self, file: BinaryIO, size: int, *, is_damage: bool) -> list[Record] | None:
        """Go on at the next whole chunk, or at the end of a file that has one."""
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
        except BombError as error:
            raise self._refused(error) from None
        except GiveUpError:
            raise LogError(
                f"{self.path}: damaged at byte {self._at}, and too much behind it looks like a log"
            ) from None
        if found is None:
            return None
        self._gap, self._at, self._sound, self._stuck = self._sound, found.end, found.end, None
        self._unpacked += found.unpacked
        return found.records

    def _ended(self, file: BinaryIO) -> None:
        """At the end: what is missing since the last message, by the file's own count."""
        if self._hurt is None:
            return
        summary = self._repeated(file)
        for name in summary.records:
            self._learn(name)
        missing = None
        if self._ours and summary.messages is not None:
            missing = max(0, summary.messages - self._sequence)
        until = None if summary.last is None else summary.last * 1e-9
        self.damages.append(Damage(self._hurt, missing, _seconds(self._stamp), until))
        self._hurt = None

    def _repeated(self, file: BinaryIO) -> Summary:
        return read_summary(file) or Summary([])

    def _rows(self, file: BinaryIO, records: list[Record]) -> Iterator[Row]:
        for record in records:
            if not isinstance(record, Message):
                self._learn(record)
                continue
            self._account(record)
            channel = self._channels.get(record.channel)
            if channel is None and not self._nameless:
                for name in self._repeated(file).records:
                    self._learn(name)
                channel = self._channels.get(record.channel)
            if channel is None:
                self._nameless += 1
                continue
            yield Row(channel.topic, record.stamp, record.data)

    def _learn(self, name: Schema | Channel) -> None:
        if isinstance(name, Schema):
            self._schemas[name.number] = name.name
            return
        self._channels[name.number] = name
        by_name = KINDS.get(name.topic.rpartition("/")[2], "")
        self.kinds[name.topic] = self._schemas.get(name.schema, by_name)

    def _account(self, message: Message) -> None:
        """Note what is missing before a message."""
        missing = max(0, message.sequence - self._sequence - 1) if self._ours else None
        if self._hurt is not None or missing:
            at = self._gap if self._hurt is None else self._hurt
            now = message.stamp * 1e-9
            self.damages.append(Damage(at, missing, _seconds(self._stamp), now))
            self._hurt = None
        self._sequence, self._stamp = message.sequence, message.stamp


def _size(file: BinaryIO) -> int:
    return file.seek(0, os.SEEK_END)


def _seconds(stamp: int | None) -> float | None:
    return None if stamp is None else stamp * 1e-9


def config_of(run: Path) -> Path:
    """The experiment file of a run folder, or of the log in one."""
    return (run if run.is_dir() else run.parent) / "config.toml"


def log_of(run: Path) -> Path:
    """The log that an operator means by a run folder or by the log itself.

    Raises:
        LogError: the folder is none of a run.
    """
    if not run.is_dir():
        return run
    if not any((run / name).exists() for name in ("log.mcap", "config.toml")):
        raise LogError(
            f"{run}\n  expected  a run folder, with a log.mcap and a config.toml in it\n"
            "  found     neither"
        )
    return run / "log.mcap"
