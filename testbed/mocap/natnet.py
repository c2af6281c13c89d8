"""OptiTrack's NatNet protocol, 3.0 to 4.1: bytes to frames and back. No socket, no clock.

Source: NatNet SDK, "NatNet: Data Types" and "NatNet: Direct Depacketization Sample". Little endian.

    packet   u16 id, u16 size of what follows
    frame    number; then a count of each kind of data and the data: marker sets, unlabelled
             markers, rigid bodies, skeletons, [4.1: assets], labelled markers, force plates,
             devices; then time stamps. From 4.1 a byte size follows every count.

Only rigid bodies are decoded; other data of a frame is skipped.
"""

import struct
from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Any

from msgspec import Struct

from testbed.core.error import TestbedError

HEAD = struct.Struct("<HH")
BODY = struct.Struct("<i3f4ffh")
STAMPS = struct.Struct("<QQQ")
OFFSET = struct.Struct("<ii3f")
INFO = struct.Struct("<256s4B4BQHB4B")
Version = tuple[int, int]


class Packet(IntEnum):
    """Number of a NatNet packet's kind."""

    CONNECT = 0
    SERVER_INFO = 1
    REQUEST = 2
    RESPONSE = 3
    REQUEST_MODEL_DEF = 4
    MODEL_DEF = 5
    REQUEST_FRAME = 6
    FRAME = 7
    MESSAGE = 8
    DISCONNECT = 9
    KEEP_ALIVE = 10
    ECHO_REQUEST = 12
    ECHO_RESPONSE = 13
    UNRECOGNIZED = 100


class NatNetError(TestbedError, ValueError):
    """The bytes are not a valid packet."""


class RigidBody(Struct, frozen=True, gc=False):
    """One body in one frame, in the axes of the motion-capture system."""

    id: int
    position: tuple[float, float, float]  # [m]
    rotation: tuple[float, float, float, float]  # quaternion x, y, z, w
    error: float  # mean distance of the markers from their expected positions [m]
    tracked: bool


class MocapFrame(Struct, frozen=True, gc=False):
    """One exposure of all cameras. Stamps are in ticks of the server's clock."""

    number: int
    bodies: tuple[RigidBody, ...]
    timestamp: float  # since the software started [s]
    exposed: int  # middle of the exposure
    received: int  # camera data complete at the server
    sent: int


class Described(Struct, frozen=True, gc=False):
    """Number and name of a rigid body in the model definition."""

    id: int
    name: str


class ServerInfo(Struct, frozen=True, gc=False):
    """The server's answer to CONNECT."""

    application: str
    version: Version  # of NatNet
    clock_hz: int
    data_port: int
    group: str | None  # address that frames are multicast to; None: unicast


def packet(kind: Packet, payload: bytes = b"") -> bytes:
    """Encode a NatNet datagram: kind, length, payload."""
    return HEAD.pack(kind, len(payload)) + payload


def unpack(datagram: bytes) -> tuple[int, memoryview]:
    """Kind and payload of a datagram.

    Raises:
        NatNetError: it is shorter than the size in its header.
    """
    if len(datagram) < HEAD.size:
        raise NatNetError(f"{len(datagram)} bytes are not a packet")
    kind, size = HEAD.unpack_from(datagram)
    if len(datagram) < HEAD.size + size:
        raise NatNetError(f"{len(datagram) - HEAD.size} bytes of {size}")
    return kind, memoryview(datagram)[HEAD.size : HEAD.size + size]


# Server to client


def _sized(data: bytes, version: Version) -> bytes:
    """Prefix a section with its size, from 4.1 on."""
    return struct.pack("<i", len(data)) + data if version >= (4, 1) else data


def encode_frame(frame: MocapFrame, version: Version) -> bytes:
    """Encode a frame of mocap data with its rigid bodies."""
    empty = struct.pack("<i", 0) + _sized(b"", version)
    bodies = b"".join(
        BODY.pack(b.id, *b.position, *b.rotation, b.error, b.tracked) for b in frame.bodies
    )
    assets = empty if version >= (4, 1) else b""
    return packet(
        Packet.FRAME,
        b"".join((
            struct.pack("<i", frame.number),
            empty,  # marker sets
            empty,  # unlabelled markers
            struct.pack("<i", len(frame.bodies)), _sized(bodies, version),
            empty,  # skeletons
            assets,
            empty * 3,  # labelled markers, force plates, devices
            struct.pack("<IId", 0, 0, frame.timestamp),  # time code, its fraction
            STAMPS.pack(frame.exposed, frame.received, frame.sent),
            struct.pack("<II", 0, 0) if version >= (4, 1) else b"",  # precision time stamp
            struct.pack("<hi", 0, 0),  # parameters, end of data
        )),
    )  # fmt: skip


def encode_models(models: Sequence[Described], version: Version) -> bytes:
    """Encode the model definition, which names the bodies."""
    parts = [struct.pack("<i", len(models))]
    for model in models:
        body = model.name.encode() + b"\0" + OFFSET.pack(model.id, -1, 0.0, 0.0, 0.0)
        body += struct.pack("<i", 0)  # markers
        parts += struct.pack("<i", 1), _sized(body, version)
    return packet(Packet.MODEL_DEF, b"".join(parts))


def encode_server_info(info: ServerInfo) -> bytes:
    """Encode the answer to CONNECT."""
    group = [int(part) for part in (info.group or "0.0.0.0").split(".")]
    name = info.application.encode()[:255]
    major, minor = info.version
    version = (major, minor, 0, 0)
    return packet(
        Packet.SERVER_INFO,
        INFO.pack(
            name, *version, *version, info.clock_hz, info.data_port, info.group is not None, *group
        ),
    )


def encode_echo(asked: int, now: int) -> bytes:
    """Encode the answer to ECHO_REQUEST: its stamp and the server's clock."""
    return packet(Packet.ECHO_RESPONSE, struct.pack("<QQ", asked, now))


# Client: decoding


class _Reader:
    """Reads a payload field by field."""

    def __init__(self, data: memoryview, version: Version) -> None:
        self.data, self.at, self.version = data, 0, version
        self.sized = version >= (4, 1)

    def take(self, layout: struct.Struct) -> tuple[Any, ...]:
        """Read the next fields."""
        try:
            values = layout.unpack_from(self.data, self.at)
        except struct.error:
            raise NatNetError(f"it is cut off at byte {len(self.data)}") from None
        self.at += layout.size
        return values

    def skip(self, size: int) -> None:
        """Skip bytes, checking that they are there."""
        if size < 0 or self.at + size > len(self.data):
            raise NatNetError(f"a size of {size} at byte {self.at} of {len(self.data)}")
        self.at += size

    def number(self) -> int:
        """Read a 32-bit integer."""
        return int(self.take(_I32)[0])

    def count(self) -> int:
        """Read the number of items, each of which has at least one byte."""
        count = self.number()
        if not 0 <= count <= len(self.data) - self.at:
            raise NatNetError(f"a count of {count} at byte {self.at - 4} of {len(self.data)}")
        return count

    def text(self) -> str:
        """Read a zero-terminated name."""
        rest = bytes(self.data[self.at : self.at + 512])
        end = rest.find(b"\0")
        if end < 0:
            raise NatNetError(f"a name without an end at byte {self.at}")
        self.at += end + 1
        return rest[:end].decode(errors="replace")

    def section(self, each: Callable[["_Reader"], object]) -> None:
        """Skip a section of a frame."""
        count = self.count()
        if self.sized:
            self.skip(self.number())
            return
        for _ in range(count):
            each(self)


_I32 = struct.Struct("<i")
_FLOAT = struct.Struct("<d")


def _marker_set(r: _Reader) -> None:
    r.text()
    r.skip(12 * r.count())


def _skeleton(r: _Reader) -> None:
    r.number()
    r.skip(BODY.size * r.count())


def _channels(r: _Reader) -> None:
    """Skip the channels of a force plate or a device."""
    r.number()
    for _ in range(r.count()):
        r.skip(4 * r.count())


def _body(values: tuple[Any, ...]) -> RigidBody:
    number, x, y, z, qx, qy, qz, qw, error, bits = values
    return RigidBody(number, (x, y, z), (qx, qy, qz, qw), error, bool(bits & 1))


def decode_frame(payload: memoryview, version: Version) -> MocapFrame:
    """Decode a frame.

    Raises:
        NatNetError: the payload is not valid in this version.
    """
    if version >= (4, 1):
        return _decode_sized(payload)
    r = _Reader(payload, version)
    number = r.number()
    r.section(_marker_set)
    r.section(lambda r: r.skip(12))  # unlabelled markers
    bodies = tuple(_body(r.take(BODY)) for _ in range(r.count()))
    r.section(_skeleton)
    r.section(lambda r: r.skip(26))  # labelled markers
    r.section(_channels)  # force plates
    r.section(_channels)  # devices
    r.skip(8)  # time code
    timestamp = r.take(_FLOAT)[0]
    exposed, received, sent = r.take(STAMPS)
    return MocapFrame(number, bodies, timestamp, exposed, received, sent)


_SECTION = struct.Struct("<ii")  # number of items, size in bytes
_TAIL = struct.Struct("<8xdQQQ")  # time code, timestamp, stamps


def _over(data: memoryview, at: int, sections: int) -> int:
    """Position after a number of sections that have their size in front."""
    end = len(data)
    for _ in range(sections):
        count, size = _SECTION.unpack_from(data, at)
        at += 8
        if not (0 <= count <= end - at + 4 and 0 <= size <= end - at):
            raise NatNetError(f"a section of {count} in {size} bytes at byte {at} of {end}")
        at += size
    return at


def _decode_sized(data: memoryview) -> MocapFrame:
    """Decode a frame of 4.1 or later; this is fast, because the flight waits for it."""
    try:
        (number,) = _I32.unpack_from(data)
        at = _over(data, 4, 2)  # marker sets, unlabelled markers
        count, size = _SECTION.unpack_from(data, at)
        first, at = at + 8, _over(data, at, 1)
        if size != count * BODY.size:
            raise NatNetError(f"{count} rigid bodies of an unexpected size")
        bodies = tuple([_body(one) for one in BODY.iter_unpack(data[first:at])])
        at = _over(data, at, 5)  # skeletons, assets, labelled markers, force plates, devices
        return MocapFrame(number, bodies, *_TAIL.unpack_from(data, at))
    except struct.error:
        raise NatNetError(f"it is cut off at byte {len(data)}") from None


def _names(r: _Reader) -> None:
    for _ in range(r.count()):
        r.text()


def _described(r: _Reader) -> Described:
    name = r.text()
    number = r.take(OFFSET)[0]
    count = r.count()
    r.skip(16 * count)  # marker positions and labels
    if r.version >= (4, 0):
        for _ in range(count):
            r.text()
    return Described(number, name)


def _other(r: _Reader, kind: int) -> None:
    """Skip a description that is not a rigid body, before 4.1."""
    match kind:
        case 0:  # marker set
            r.text()
            _names(r)
        case 2:  # skeleton
            r.text()
            r.number()
            for _ in range(r.count()):
                _described(r)
        case 3:  # force plate: size, origin, calibration, corners
            r.number()
            r.text()
            r.skip(8 + 12 + 576 + 48 + 8)
            _names(r)
        case 4:  # device
            r.number()
            r.text()
            r.text()
            r.skip(8)
            _names(r)
        case 5:  # camera
            r.text()
            r.skip(28)
        case _:
            raise NatNetError(f"a description of kind {kind}")


def decode_models(payload: memoryview, version: Version) -> list[Described]:
    """Decode the rigid bodies of a model definition.

    Raises:
        NatNetError: the payload is not valid in this version.
    """
    r = _Reader(payload, version)
    models = []
    for _ in range(r.count()):
        kind = r.number()
        size = r.number() if r.sized else 0
        start = r.at
        if kind == 1:
            models.append(_described(r))
        elif not r.sized:
            _other(r, kind)
        if r.sized:
            r.at = start
            r.skip(size)
    return models


def decode_server_info(payload: memoryview) -> ServerInfo:
    """Decode the answer to CONNECT; NatNetError if the payload is not valid."""
    if len(payload) < INFO.size:
        raise NatNetError(f"a server's answer of {len(payload)} bytes, expected {INFO.size}")
    values = INFO.unpack_from(payload)
    name = values[0].partition(b"\0")[0].decode(errors="replace")
    if values[9] == 0:
        raise NatNetError("a server's clock that stands still")
    group = ".".join(map(str, values[12:16])) if values[11] else None
    return ServerInfo(name, (values[5], values[6]), values[9], values[10], group)


def decode_echo(payload: memoryview) -> tuple[int, int]:
    """Decode an echo: the client's stamp and the server's clock.

    Raises:
        NatNetError: the payload is not valid.
    """
    if len(payload) < 16:
        raise NatNetError(f"an echo of {len(payload)} bytes, expected 16")
    asked, now = struct.unpack_from("<QQ", payload)
    return asked, now
