"""Where a damaged log goes on: the search for the next whole chunk."""

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
)  # the look-ahead finds beginnings that overlap
_SPAN = 9 + 28 + 8  # [bytes] that the pattern looks at
_BLOCK = 2**20  # [bytes] looked through at once
_PATIENCE = 16  # unpacks no more than so many times the file in vain
_AT_LEAST = 512 * 2**20  # [bytes] of patience with a small file


class GiveUpError(Exception):
    """Too much of the file looks like chunks that are none."""


class Found(NamedTuple):
    """A whole chunk."""

    at: int
    end: int
    unpacked: int  # [bytes]
    records: list[Record]


class Search:
    """Looks for whole chunks; its patience is for the whole file."""

    def __init__(self) -> None:
        self._spent = 0  # [bytes] of chunks that were none

    def next_chunk(self, file: BinaryIO, start: int, size: int, allowance: int) -> Found | None:
        """The first whole chunk that begins at `start` or later in a file of `size` bytes.

        Raises:
            GiveUpError: it would take too long.
            BombError: it unpacks to more than `allowance` bytes.
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
