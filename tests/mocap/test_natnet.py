"""NatNet on the wire: our codec against itself, garbage, and two clients of others."""

import math
import struct
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from testbed.mocap.natnet import (
    Described,
    MocapFrame,
    NatNetError,
    Packet,
    RigidBody,
    ServerInfo,
    decode_echo,
    decode_frame,
    decode_models,
    decode_server_info,
    encode_echo,
    encode_frame,
    encode_models,
    encode_server_info,
    unpack,
)

VERSIONS = [(3, 0), (3, 1), (4, 0), (4, 1)]
single = st.floats(width=32, allow_nan=False)
stamp = st.integers(0, 2**64 - 1)
bodies = st.builds(
    RigidBody,
    id=st.integers(-(2**31), 2**31 - 1),
    position=st.tuples(single, single, single),
    rotation=st.tuples(single, single, single, single),
    error=single,
    tracked=st.booleans(),
)
frames = st.builds(
    MocapFrame,
    number=st.integers(0, 2**31 - 1),
    bodies=st.lists(bodies, max_size=6).map(tuple),
    timestamp=st.floats(allow_nan=False),
    exposed=stamp,
    received=stamp,
    sent=stamp,
)


def payload(datagram, kind):
    found, data = unpack(datagram)
    assert found == kind
    return data


@pytest.mark.parametrize("version", VERSIONS)
@given(frame=frames)
@settings(max_examples=50, deadline=None)
def test_a_frame_comes_back(version, frame):
    data = payload(encode_frame(frame, version), Packet.FRAME)
    assert decode_frame(data, version) == frame


@pytest.mark.parametrize("version", VERSIONS)
def test_names_come_back(version):
    models = [Described(1, "sat1"), Described(7, "Körper")]
    assert (
        decode_models(payload(encode_models(models, version), Packet.MODEL_DEF), version) == models
    )


@pytest.mark.parametrize("group", [None, "239.255.42.99"])
def test_who_the_server_is_comes_back(group):
    info = ServerInfo("Motive", (4, 1), 10_000_000, 1511, group)
    assert decode_server_info(payload(encode_server_info(info), Packet.SERVER_INFO)) == info


def test_an_echo_comes_back():
    assert decode_echo(payload(encode_echo(5, 77), Packet.ECHO_RESPONSE)) == (5, 77)


def section(version, count, data):
    size = struct.pack("<i", len(data)) if version >= (4, 1) else b""
    return struct.pack("<i", count) + size + data


def crowded(version):
    """A frame as a busy lab streams it, written field by field."""
    body = struct.pack("<i3f4ffh", 3, 1, 2, 3, 0, 0, 0, 1, 0.5, 1)
    marker_set = b"hull\0" + struct.pack("<i6f", 2, *range(6))
    skeleton = struct.pack("<ii", 9, 1) + body
    asset = struct.pack("<ii", 4, 1) + body + struct.pack("<ii4fhf", 1, 5, 1, 1, 1, 1, 0, 0.1)
    labelled = struct.pack("<i4fhf", 1, 0, 0, 0, 0.1, 0, 0.2)
    plate = struct.pack("<iiifif", 1, 2, 1, 0.5, 1, 0.25)
    return b"".join([
        struct.pack("<i", 42),
        section(version, 1, marker_set),
        section(version, 2, bytes(24)),
        section(version, 1, body),
        section(version, 1, skeleton),
        section(version, 1, asset) if version >= (4, 1) else b"",
        section(version, 1, labelled),
        section(version, 1, plate),
        section(version, 1, plate),
        struct.pack("<IIdQQQ", 0, 0, 1.5, 10, 20, 30),
        struct.pack("<II", 0, 0) if version >= (4, 1) else b"",
        struct.pack("<hi", 0, 0),
    ])  # fmt: skip


@pytest.mark.parametrize("version", VERSIONS)
def test_everything_else_in_a_frame_is_stepped_over(version):
    frame = decode_frame(memoryview(crowded(version)), version)
    assert frame.bodies == (RigidBody(3, (1, 2, 3), (0, 0, 0, 1), 0.5, True),)
    assert (frame.number, frame.exposed, frame.received, frame.sent) == (42, 10, 20, 30)


@pytest.mark.parametrize("version", VERSIONS)
def test_everything_else_in_a_model_definition_is_stepped_over(version):
    def described(kind, data):
        size = struct.pack("<i", len(data)) if version >= (4, 1) else b""
        return struct.pack("<i", kind) + size + data

    marker = struct.pack("<3fi", 0, 0, 0, 1) + (b"m\0" if version >= (4, 0) else b"")
    body = b"sat1\0" + struct.pack("<ii3fi", 1, -1, 0, 0, 0, 1) + marker
    plate = struct.pack("<i", 1) + b"s\0" + bytes(8 + 12 + 576 + 48 + 8) + b"\1\0\0\0Fz\0"
    data = struct.pack("<i", 6) + b"".join([
        described(0, b"hull\0" + struct.pack("<i", 1) + b"m1\0"),
        described(2, b"man\0" + struct.pack("<ii", 1, 1) + body),
        described(3, plate),
        described(4, struct.pack("<i", 1) + b"d\0s\0" + bytes(8) + b"\1\0\0\0c\0"),
        described(5, b"cam\0" + bytes(28)),
        described(1, body),
    ])  # fmt: skip
    assert decode_models(memoryview(data), version) == [Described(1, "sat1")]


@pytest.mark.parametrize("version", VERSIONS)
def test_a_frame_cut_anywhere_is_refused_or_whole(version):
    whole = crowded(version)
    for length in range(len(whole)):
        try:
            frame = decode_frame(memoryview(whole[:length]), version)
        except NatNetError:
            continue
        assert frame.sent == 30  # only what follows the stamps was cut


def test_garbage_is_refused_and_nothing_else_happens():
    rng = np.random.default_rng(5)
    whole = {version: bytearray(crowded(version)) for version in VERSIONS}
    refused = 0
    for _ in range(20_000):
        version = VERSIONS[rng.integers(len(VERSIONS))]
        data = bytearray(whole[version])
        for _ in range(rng.integers(1, 4)):
            data[rng.integers(len(data))] = rng.integers(256)
        for decode in (decode_frame, decode_models):
            try:
                decode(memoryview(bytes(data)), version)
            except NatNetError:
                refused += 1
    assert refused > 10_000


@given(st.binary(max_size=200))
@settings(deadline=None)
def test_any_bytes_are_refused_or_understood(data):
    for decode in (
        unpack, decode_server_info, decode_echo,
        lambda d: decode_frame(memoryview(d), (4, 1)),
        lambda d: decode_models(memoryview(d), (3, 1)),
    ):  # fmt: skip
        with suppress(NatNetError):
            decode(data)


def test_an_enormous_count_costs_no_time():
    data = struct.pack("<ii", 1, 2**31 - 1)
    with pytest.raises(NatNetError, match="a count of 2147483647"):
        decode_frame(memoryview(data), (3, 1))


def test_numbers_of_the_wire_are_single_precision():
    body = RigidBody(1, (math.pi, 0, 0), (0, 0, 0, 1), 0, True)
    data = payload(encode_frame(MocapFrame(1, (body,), 0, 0, 0, 0), (4, 1)), Packet.FRAME)
    seen = decode_frame(data, (4, 1)).bodies[0].position[0]
    assert seen == np.float32(math.pi)
    assert abs(seen - math.pi) < 1e-7  # 0.1 um on a table of metres
