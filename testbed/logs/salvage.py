"""Searches a damaged log for the next intact chunk."""

import re
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode

from testbed.logs.mcap_record import (
    HEAD,
    LARGEST,
    BrokenError,
    CutOffError,
    Record,
    read_chunk,
    read_head,
    unpacked_size,
)

# A chunk's opcode, a length below 2^32, times, size, checksum, and the name of its compression.
_LOOKS_LIKE = re.compile(
    rb"(?=\x06[\s\S]{4}\0\0\0\0[\s\S]{28}(?:\x04\0\0\0zstd|\0\0\0\0))"
)  # the look-ahead finds overlapping candidates
_SPAN = 9 + 28 + 8  # length of the pattern [bytes]
_BLOCK = 2**20  # bytes searched at once
_PATIENCE = 16  # most bytes unpacked in vain, as a multiple of the file's size
_AT_LEAST = 512 * 2**20  # the same for a small file [bytes]


class GiveUpError(Exception):
    """Too much of the file looks like chunks but is not."""


class Found(NamedTuple):
    """Position and contents of the next intact chunk."""

    at: int
    end: int
    unpacked: int  # [bytes]
    records: list[Record]


class Search:
    """Searches for intact chunks; its effort is limited per file."""

    def __init__(self) -> None:
        self._spent = 0  # bytes unpacked in vain

    def next_chunk(self, file: BinaryIO, start: int, size: int, allowance: int) -> Found | None:
        """The first intact chunk that begins at `start` or later in a file of `size` bytes.

        Raises:
            GiveUpError: it would take too long.
            ChunkTooLargeError: it unpacks to more than `allowance` bytes.
        """
        at = start
        while at < size:
            file.seek(at)
            block = file.read(_BLOCK + _SPAN)
            for match in _LOOKS_LIKE.finditer(block):
                if match.start() >= _BLOCK:
                    break
                if found := self._chunk(file, at + match.start(), size, allowance):
                    return found
            at += _BLOCK
        return None

    def _chunk(self, file: BinaryIO, at: int, size: int, allowance: int) -> Found | None:
        try:
            opcode, length = read_head(file, at, size)
            assert opcode == Opcode.CHUNK
            body = file.read(length)
            unpacked = unpacked_size(body)
            effort = length + min(unpacked, LARGEST)
            self._spent += effort
            if self._spent > _AT_LEAST + _PATIENCE * size:
                raise GiveUpError
            records = read_chunk(body, allowance)
        except (BrokenError, CutOffError):
            return None
        self._spent -= effort
        return Found(at, at + HEAD.size + length, unpacked, records)
