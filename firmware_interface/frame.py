"""Frames on the line: COBS(version | type | seq | t_us | payload | crc32) 0x00, little endian.

COBS: S. Cheshire and M. Baker, "Consistent Overhead Byte Stuffing", IEEE/ACM Transactions on
Networking 7(2), 1999.
"""

import struct
import zlib
from typing import NamedTuple

from firmware_interface.messages import PAYLOAD_MAX, TYPES, VERSION, Message
from testbed.core.error import TestbedError

HEADER = struct.Struct("<BBHI")
CRC = struct.Struct("<I")
RAW_MAX = HEADER.size + PAYLOAD_MAX + CRC.size
CODED_MAX = RAW_MAX + 1  # below 255 bytes COBS costs one byte
WRAP = 1 << 32  # of clocks [us]


_LENGTH = [bytes([size + 1]) for size in range(255)]  # COBS code bytes by block length


class Frame(NamedTuple):
    """One decoded frame, in either direction."""

    type: int
    seq: int
    t_us: int  # sender's clock
    payload: bytes
    version: int = VERSION

    @property
    def message(self) -> Message:
        """The decoded payload; KeyError, struct.error or ValueError if it is invalid."""
        return TYPES[self.type].unpack(self.payload)


class BadFrameError(TestbedError):
    """Bytes between two delimiters are not a valid frame; the reason is a counter's name."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


def stuff(raw: bytes) -> bytes:
    """Encode with COBS, without delimiter, below 255 bytes."""
    return b"".join([_LENGTH[len(block)] + block for block in raw.split(b"\0")])


def unstuff(coded: bytes) -> bytes:
    """Decode COBS.

    Raises:
        BadFrameError: a block reaches beyond the end.
    """
    blocks = []
    while coded:
        size = coded[0]
        if size == 0 or size > len(coded):
            raise BadFrameError("bad_length")
        blocks.append(coded[1:size])
        coded = coded[size:]
    return b"\0".join(blocks)


def encode(frame: Frame) -> bytes:
    """Bytes for the line, with the delimiter."""
    head = HEADER.pack(frame.version, frame.type, frame.seq & 0xFFFF, frame.t_us % WRAP)
    raw = head + frame.payload
    return stuff(raw + CRC.pack(zlib.crc32(raw))) + b"\0"


def encode_message(message: Message, seq: int, t_us: int) -> bytes:
    """Bytes for the line.

    Raises:
        ValueError: a field is outside the limits of messages.toml.
    """
    for name, (least, most) in message.LIMITS.items():
        value = getattr(message, name)
        smallest, largest = (min(value), max(value)) if isinstance(value, tuple) else (value, value)
        if smallest < least or largest > most:
            one = smallest if smallest < least else largest
            raise ValueError(
                f"{type(message).__name__}.{name} is {one}, expected {least} to {most}"
            )
    return encode(Frame(message.CODE, seq, t_us, message.pack()))


def decode(coded: bytes) -> Frame:
    """The frame between two delimiters.

    Raises:
        BadFrameError: invalid frame; checks have the firmware's order, except for the version,
            which the caller checks.
    """
    if len(coded) > CODED_MAX:
        raise BadFrameError("bad_length")
    raw = unstuff(coded)
    if len(raw) < HEADER.size + CRC.size:
        raise BadFrameError("bad_length")
    if zlib.crc32(raw[: -CRC.size]) != CRC.unpack(raw[-CRC.size :])[0]:
        raise BadFrameError("bad_crc")
    version, kind, seq, t_us = HEADER.unpack_from(raw)
    return Frame(kind, seq, t_us, raw[HEADER.size : -CRC.size], version)


class Decoder:
    """Splits a stream of bytes into frames and counts invalid ones."""

    def __init__(self) -> None:
        self._rest = b""
        self.bad: dict[str, int] = {}

    def feed(self, data: bytes) -> list[Frame]:
        """Frames completed by these bytes."""
        *coded, rest = (self._rest + data).split(b"\0")
        self._rest = rest[: CODED_MAX + 1]  # one byte too many marks the frame as too long
        frames = []
        for one in filter(None, coded):
            try:
                frames.append(decode(one))
            except BadFrameError as bad:
                self.bad[bad.reason] = self.bad.get(bad.reason, 0) + 1
        return frames
