"""Whatever comes out of a serial port, the sender takes it, counts it, or says what is wrong.

ABT_FUZZ is the number of chunks of the long test, ABT_ROUND its seed; `make fuzz` sets them.
"""

import os
import tracemalloc
from contextlib import suppress

import numpy as np
import pytest

from firmware_interface.frame import CODED_MAX, Frame, encode, encode_message
from firmware_interface.messages import TYPES, VERSION, HelloAck, ResetCause, State
from firmware_interface.reports import KEPT, Reports
from firmware_interface.session import EDGES_KEPT, EXCHANGES, Session, SessionError

CHUNKS = int(os.environ.get("ABT_FUZZ", "9000"))
ROUND = int(os.environ.get("ABT_ROUND", "0"))
FROM_BOARD = [kind for code, kind in TYPES.items() if code >= 128]


def random_message(rng):
    """A frame of the board with any field at all, also outside of its enumeration."""
    kind = FROM_BOARD[rng.integers(len(FROM_BOARD))]
    size = kind.LAYOUT.size
    payload = bytearray(rng.bytes(size))
    if rng.random() < 0.8:  # plausible but for some bytes
        payload = bytearray(bytes([rng.choice([0, 0, 0, 255])]) * size)
        for at in rng.integers(size, size=rng.integers(4)):
            payload[at] = rng.integers(256)
    if rng.random() < 0.05:
        payload = payload[: rng.integers(size + 1)] + rng.bytes(int(rng.integers(5)))
    code = int(rng.integers(256)) if rng.random() < 0.05 else kind.CODE
    version = VERSION if rng.random() < 0.99 else int(rng.integers(256))
    seq, t_us = int(rng.integers(1 << 16)), int(rng.integers(1 << 32))
    return encode(Frame(code, seq, t_us, bytes(payload), version))


def chunk(rng):
    """Bytes as they come in one read."""
    sort = rng.random()
    if sort < 0.5:
        return b"".join(random_message(rng) for _ in range(rng.integers(4)))
    frame = bytearray(random_message(rng))
    if sort < 0.7:
        frame[rng.integers(len(frame))] ^= 1 << int(rng.integers(8))
        return bytes(frame)
    if sort < 0.85:
        return bytes(frame[: rng.integers(len(frame))])
    return rng.bytes(int(rng.integers(300)))


def greeting(session, limits, now):
    """HELLO_ACK of the right board."""
    session.hello(now)
    ack = HelloAck(5, 77, 1, 2, session._hash, ResetCause.POWER_ON, State.SAFE, now, now)
    session.receive(b"\0" + encode_message(ack, 1, now), now)


@pytest.mark.parametrize("seed", range(3))
def test_nothing_a_board_says_breaks_the_session(limits, seed):
    rng = np.random.default_rng((ROUND, seed))
    session, reports, now = Session(limits, nonce=5), Reports(), 0
    greeting(session, limits, now)
    refused = taken = 0
    for number in range(CHUNKS // 3):
        now += int(rng.integers(20_000))
        data = chunk(rng)
        reports.receive(data, now)
        try:
            taken += len(session.receive(data, now))
        except SessionError:  # another version, or other limits
            refused += 1
        if number % 1_000 == 0:
            greeting(session, limits, now)
        if session.greeted:
            session.arm(now)
        session.due(now)
        assert session.clock is None or 0 <= session.clock.offset_us < 1 << 32
        assert len(session._exchanges) <= EXCHANGES
        assert len(session.edges) <= EDGES_KEPT
        assert len(session._decoder._rest) <= CODED_MAX + 1
        assert len(reports._edges) <= KEPT
    assert refused > 0
    assert taken > CHUNKS / 10
    for reason in ("bad_length", "bad_crc", "unknown"):
        assert session.bad_frames[reason] > CHUNKS / 1_000


def test_a_hostile_board_takes_no_memory(limits):
    rng = np.random.default_rng((ROUND, 7))
    session, now = Session(limits, nonce=5), 0

    def feed(count):
        nonlocal now
        for _ in range(count):
            now += 10_000
            with suppress(SessionError):
                session.receive(chunk(rng), now)

    tracemalloc.start()
    feed(12_000)  # until what is kept is full
    before, _ = tracemalloc.get_traced_memory()
    feed(CHUNKS // 3)
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert after - before < 100_000


def test_what_is_dropped_is_counted_to_the_last_frame(limits):
    rng = np.random.default_rng(9)
    session = Session(limits, nonce=5)
    stream = b"".join(chunk(rng) + b"\0" for _ in range(2_000))
    frames = sum(1 for coded in stream.split(b"\0") if coded)
    taken = refused = 0
    for coded in stream.split(b"\0"):
        try:
            taken += len(session.receive(coded + b"\0", 0))
        except SessionError:
            refused += 1
    assert taken + refused + sum(session.bad_frames.values()) == frames


def test_a_line_without_delimiters_takes_no_memory(limits):
    session = Session(limits, nonce=5)
    noise = b"\x55" * 4096
    session.receive(noise, 0)
    tracemalloc.start()
    for _ in range(500):  # two megabytes
        session.receive(noise, 0)
    grown, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert grown < 20_000
    session.receive(b"\0", 0)
    assert session.bad_frames == {"bad_length": 1}
