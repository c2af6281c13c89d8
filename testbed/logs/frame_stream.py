"""Frames as a stream of bytes, from the recorder to the writer's process, and back.

A frame is its length (4 bytes) and MessagePack. The memory of its stacks goes before it, each with
its length and the bit BESIDE: packing would copy it.
"""

from collections import deque
from collections.abc import Iterable, Iterator

import msgspec

from testbed.logs.frames import Frame, Messages, One, Stack, Table

BESIDE = 1 << 31  # in a length: what follows is memory of the next frame's stacks, not a frame
NONE = memoryview(b"")

_pack = msgspec.msgpack.Encoder().encode


def pieces_of(frame: Frame) -> Iterator[bytes | memoryview]:
    """The stream of a frame; a view is the frame's own memory."""
    frame, memory = apart(frame) if isinstance(frame, Messages) else (frame, [])
    packed = _pack(frame)  # before the first piece: after an error nothing is sent
    for data in memory:
        yield (len(data) | BESIDE).to_bytes(4, "little")
        yield data
    yield len(packed).to_bytes(4, "little") + packed


def frames_of(pieces: Iterable[bytes]) -> Iterator[Frame]:
    """Frames of a stream, cut anywhere; a frame that is cut off at the end is dropped."""
    decode = msgspec.msgpack.Decoder(Frame).decode
    held, memory = bytearray(), deque[bytes]()
    for piece in pieces:
        held += piece
        at = 0
        while len(held) - at >= 4:
            length = int.from_bytes(held[at : at + 4], "little")
            end = at + 4 + (length & ~BESIDE)
            if end > len(held):
                break
            data = bytes(held[at + 4 : end])  # a copy: the frame keeps parts of it
            if length & BESIDE:
                memory.append(data)
            else:
                yield joined(decode(data), memory)
            at = end
        del held[:at]


def apart(frame: Messages) -> tuple[Messages, list[memoryview]]:
    """The frame without the memory of its stacks, and this memory: packing would copy it."""
    memory: list[memoryview] = []
    parts: list[One | Table] = []
    for part in frame.parts:
        if isinstance(part, Table):
            memory += [one.data for stacks in part.columns for one in stacks]
            columns = [[Stack(one.pitch, one.spare, NONE) for one in s] for s in part.columns]
            part = Table(part.topics, part.stamps, columns, part.between)
        parts.append(part)
    return Messages(parts), memory


def joined(frame: Frame, memory: deque[bytes]) -> Frame:
    """The frame with the memory of its stacks, which is taken from these; see `apart`."""
    if not memory or not isinstance(frame, Messages):
        return frame
    parts: list[One | Table] = []
    for part in frame.parts:
        if isinstance(part, Table):
            columns = [
                [Stack(one.pitch, one.spare, memoryview(memory.popleft())) for one in stacks]
                for stacks in part.columns
            ]
            part = Table(part.topics, part.stamps, columns, part.between)
        parts.append(part)
    return Messages(parts)
