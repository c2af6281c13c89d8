"""Records of an MCAP file, read with bounds checks: inconsistent records are refused.

A file is records of a byte, a length and a body. Messages are in compressed chunks, each with a
checksum. Every length is checked before it is used, so memory and time are bounded by
the file's size, also for a damaged or hostile file.
"""

import os
import struct
import zlib
from collections.abc import Iterator
from typing import BinaryIO, NamedTuple

import zstandard
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

HEAD = struct.Struct("<BQ")  # opcode and length of a record
LARGEST = 8 * 2**20  # largest chunk, packed or not [bytes]; the writer's have 1 MB
RATIO = 64  # largest compression ratio of a log; real ones have 4 to 30
NAMES = 2**16  # most schemas and channels in a chunk: their numbers have 16 bits

_CHUNK = struct.Struct("<QQQI")  # first and last time [ns], unpacked size, checksum
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time [ns]
_FOOTER = struct.Struct("<BQQQI")  # head, start of summary and offsets, checksum
_TAIL = _FOOTER.size + len(MCAP0_MAGIC)  # bytes after the summary of a finished file
_BLOCK = 2**20  # [bytes] read at once for a checksum

DATA = {  # opcodes of the records before the summary
    Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK,
    Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.DATA_END,
}  # fmt: skip
SKIPPED = {Opcode.MESSAGE, Opcode.ATTACHMENT, Opcode.METADATA}  # only other writers put them here


class BrokenError(Exception):
    """The bytes are not a record, or the record is damaged."""


class CutOffError(Exception):
    """The file ends within the record."""


class ChunkTooLargeError(Exception):
    """The chunk is intact, but unpacks to more than the limit."""


class Schema(NamedTuple):
    """Schema record: name of a kind of message."""

    number: int
    name: str
    text: str = ""


class Channel(NamedTuple):
    """Channel record: name of a topic."""

    number: int
    schema: int
    topic: str


class Message(NamedTuple):
    """Message record."""

    channel: int
    sequence: int  # counts all messages of a log of this software
    stamp: int  # [ns]
    data: bytes


class FileSummary(NamedTuple):
    """The summary at the end of a file."""

    records: list[Schema | Channel]
    messages: int | None = None  # in the file; None: not counted
    last: int | None = None  # time of the last message [ns]


Record = Schema | Channel | Message


class _Cursor:
    """Reads fields from a body."""

    def __init__(self, body: bytes, at: int = 0) -> None:
        self._body, self._at = body, at

    def number(self, size: int) -> int:
        return int.from_bytes(self.bytes(size), "little")

    def bytes(self, size: int) -> bytes:
        data = self._body[self._at : self._at + size]
        if len(data) < size:
            raise BrokenError("a record is shorter than it says")
        self._at += size
        return data

    def text(self) -> str:
        try:
            return self.bytes(self.number(4)).decode()
        except UnicodeDecodeError:
            raise BrokenError("a name is not text") from None

    def end(self) -> None:
        if self._at != len(self._body):
            raise BrokenError("a record is longer than it says")


def read_head(file: BinaryIO, at: int, size: int) -> tuple[int, int]:
    """Opcode and length of the record at `at` in a file of `size` bytes.

    Raises:
        BrokenError: there is no record of a log's data section.
        CutOffError: the file ends before the record.
    """
    file.seek(at)
    head = file.read(HEAD.size)
    if head and head[0] not in DATA:
        raise BrokenError(f"no record begins with {head[0]}")
    if len(head) < HEAD.size:
        raise CutOffError
    opcode, length = HEAD.unpack(head)
    if opcode not in SKIPPED and length > LARGEST:
        raise BrokenError(f"a record of {length} bytes")
    if at + HEAD.size + length > size:
        raise CutOffError
    return opcode, length


def read_library(body: bytes) -> str:
    """The software that wrote the file, from its header."""
    cursor = _Cursor(body)
    cursor.text()
    library = cursor.text()
    cursor.end()
    return library


def read_name(opcode: int, body: bytes) -> Schema | Channel:
    """Decode a schema or a channel."""
    cursor = _Cursor(body)
    number = cursor.number(2)
    found: Schema | Channel
    if opcode == Opcode.SCHEMA:
        name = cursor.text()
        cursor.text()  # encoding
        found = Schema(number, name, cursor.text())
    else:
        schema = cursor.number(2)
        found = Channel(number, schema, cursor.text())
        cursor.text()  # encoding
        cursor.bytes(cursor.number(4))
    cursor.end()
    return found


def check_index(body: bytes) -> None:
    """Check the format of a chunk's message index; its contents are not used."""
    cursor = _Cursor(body)
    cursor.number(2)
    cursor.bytes(cursor.number(4))
    cursor.end()


def read_chunk(body: bytes, allowance: int) -> list[Record]:
    """All records of a chunk; an error if any of it is damaged.

    Raises:
        BrokenError: it is damaged.
        ChunkTooLargeError: it unpacks to more than `allowance` bytes.
    """
    size = unpacked_size(body)
    checksum = _CHUNK.unpack_from(body)[3]
    cursor = _Cursor(body, _CHUNK.size)
    compression = cursor.text()
    packed = cursor.bytes(cursor.number(8))
    cursor.end()
    data = _unpacked(compression, packed, size, min(allowance, LARGEST))
    if checksum and zlib.crc32(data) != checksum:
        raise BrokenError("the checksum of a chunk is wrong")
    return list(_inside(data))


def unpacked_size(body: bytes) -> int:
    """The unpacked size in a chunk's header [bytes].

    Raises:
        BrokenError: the chunk is too short.
    """
    if len(body) < _CHUNK.size:
        raise BrokenError("a chunk without a beginning")
    size: int = _CHUNK.unpack_from(body)[2]
    return size


def _unpacked(compression: str, packed: bytes, size: int, limit: int) -> bytes:
    if compression == "":
        stated = len(packed)
    elif compression == "zstd":
        try:
            stated = zstandard.frame_content_size(packed)
        except zstandard.ZstdError as error:
            raise BrokenError(str(error)) from None
    else:
        raise BrokenError(f"a compression {compression!r}, not zstd")
    if stated not in (size, -1):
        raise BrokenError("a chunk is of another size than it says")
    if size > limit:
        raise ChunkTooLargeError(f"a chunk of {len(packed)} bytes would unpack to {size}")
    if compression == "":
        return packed
    try:
        data = zstandard.ZstdDecompressor().decompress(packed, max_output_size=size)
    except zstandard.ZstdError as error:
        raise BrokenError(str(error)) from None
    if len(data) != size:
        raise BrokenError("a chunk is of another size than it says")
    return data


def _inside(data: bytes) -> Iterator[Record]:
    at, end, names = 0, len(data), 0
    while at < end:
        if end - at < HEAD.size:
            raise BrokenError("a chunk ends within a record")
        opcode, length = HEAD.unpack_from(data, at)
        at += HEAD.size
        if length > end - at:
            raise BrokenError("a chunk ends within a record")
        if opcode == Opcode.MESSAGE:
            if length < _MESSAGE.size:
                raise BrokenError("a message without a beginning")
            channel, sequence, stamp, _ = _MESSAGE.unpack_from(data, at)
            yield Message(channel, sequence, stamp, data[at + _MESSAGE.size : at + length])
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL) and names < NAMES:
            names += 1
            yield read_name(opcode, data[at : at + length])
        else:
            raise BrokenError(f"no record in a chunk begins with {opcode}")
        at += length


def read_summary(file: BinaryIO) -> FileSummary | None:
    """The summary at the end of the file; None if it is missing or damaged."""
    size = file.seek(0, os.SEEK_END)
    if size < len(MCAP0_MAGIC) + _TAIL:
        return None
    file.seek(size - _TAIL)
    tail = file.read(_TAIL)
    opcode, length, start, _, checksum = _FOOTER.unpack_from(tail)
    if tail[_FOOTER.size :] != MCAP0_MAGIC or (opcode, length) != (Opcode.FOOTER, 20):
        return None
    if start == 0:
        return FileSummary([])
    if not len(MCAP0_MAGIC) <= start <= size - _TAIL:
        return None
    found = 0
    file.seek(start)
    left = size - _TAIL - start
    beginning = b""  # names and numbers come before the index, which may be long
    while left:
        block = file.read(min(_BLOCK, left))
        if not block:
            return None
        found, left = zlib.crc32(block, found), left - len(block)
        if len(beginning) < LARGEST:
            beginning += block
    if checksum and zlib.crc32(tail[: _FOOTER.size - 4], found) != checksum:
        return None
    try:
        return _summary(beginning)
    except BrokenError:
        return None


def _summary(data: bytes) -> FileSummary:
    records: list[Schema | Channel] = []
    messages, last, at = None, None, 0
    while len(data) - at >= HEAD.size:
        opcode, length = HEAD.unpack_from(data, at)
        body = data[at + HEAD.size : at + HEAD.size + length]
        at += HEAD.size + length
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            records.append(read_name(opcode, body))
        elif opcode == Opcode.STATISTICS:
            cursor = _Cursor(body)
            messages = cursor.number(8)
            cursor.bytes(2 + 4 + 4 + 4 + 4 + 8)
            last = cursor.number(8)
    return FileSummary(records, messages, last)
