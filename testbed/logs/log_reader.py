"""Reading a log of record, also while it is being written and after its writer was killed.

A log is MCAP: records of a byte, a length and a body. Messages are in chunks; the last chunk may be
cut off, and everything before it is whole. The reader remembers how far it got, so the same one
serves a finished file and one that grows.
"""

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import NamedTuple, TypeVar

import msgspec
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC
from msgspec import Struct

S = TypeVar("S", bound=Struct)

HEAD = 9  # [bytes] opcode and length of a record


class LogError(Exception):
    """It is not there, or it is not a log."""


class Row(NamedTuple):
    """One message as it lies in the file."""

    topic: str
    stamp: int  # time of the run [ns]
    data: bytes  # JSON


class LogReader:
    """A log, read from the beginning on.

    Raises:
        LogError: there is no file, or it is something else.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.finished = False  # it was ended properly, and the end was read
        self.kinds: dict[str, str] = {}  # topic -> name of its schema
        self._schemas: dict[int, str] = {}
        self._topics: dict[int, str] = {}
        try:
            with path.open("rb") as file:
                magic = file.read(len(MCAP0_MAGIC))
        except OSError as error:
            raise LogError(f"{path}: {error.strerror}") from None
        if not MCAP0_MAGIC.startswith(magic):
            raise LogError(f"{path}\n  expected  an MCAP file\n  found     {magic!r}")
        self._at = len(MCAP0_MAGIC)

    def read(self) -> Iterator[Row]:
        """Every message that has been written since the last call, in the order of writing."""
        with self.path.open("rb") as file:
            while not self.finished:
                file.seek(self._at)
                head = file.read(HEAD)
                if len(head) < HEAD:
                    return
                opcode, size = head[0], int.from_bytes(head[1:], "little")
                if opcode != Opcode.CHUNK:
                    if file.seek(0, 2) < self._at + HEAD + size:
                        return
                    self._at += HEAD + size
                    self.finished = opcode == Opcode.DATA_END
                    continue
                body = file.read(size)
                if len(body) < size:
                    return
                self._at += HEAD + size
                yield from self._messages(body)

    def _messages(self, body: bytes) -> Iterator[Row]:
        try:
            records = breakup_chunk(Chunk.read(ReadDataStream(BytesIO(body))), validate_crc=True)
        except (McapError, ValueError) as error:
            raise LogError(
                f"{self.path}: damaged at byte {self._at - len(body)}: {error}"
            ) from None
        for record in records:
            match record:
                case Schema(id=number, name=name):
                    self._schemas[number] = name
                case Channel(id=number, topic=topic, schema_id=schema):
                    self._topics[number] = topic
                    self.kinds[topic] = self._schemas.get(schema, "")
                case Message(channel_id=number, log_time=stamp, data=data):
                    yield Row(self._topics[number], stamp, data)


def reads(kind: type[S]) -> msgspec.json.Decoder[S]:
    """Decoder of a topic's messages; numbers that are none may be spelled out."""
    return msgspec.json.Decoder(kind, strict=False)


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
