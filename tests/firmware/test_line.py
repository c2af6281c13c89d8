"""Bytes on the line: what is dropped, what is counted, and what never feeds the watchdog."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_interface.frame import (
    CODED_MAX,
    BadFrameError,
    Decoder,
    Frame,
    decode,
    encode,
    encode_message,
    stuff,
    unstuff,
)
from firmware_interface.messages import (
    PAYLOAD_MAX,
    VERSION,
    Cmd,
    Fault,
    Hello,
    Ping,
    Result,
    State,
)

COUNTERS = ("bad_length", "bad_crc", "bad_version", "unknown_type", "foreign", "replayed")


def refresh(host, **frame):
    payload = Cmd(host.session, 1, 0, 900_000, (300_000,) + (0,) * 7, (0,) * 8).pack()
    return Frame(**({"type": Cmd.CODE, "seq": 500, "t_us": 0, "payload": payload} | frame))


BAD = {
    "flipped bit": (lambda h: encode(refresh(h)).replace(b"\x93\x04", b"\x92\x04"), "bad_crc"),
    "truncated": (lambda h: encode(refresh(h))[:40] + b"\0", None),
    "too short": (lambda _: stuff(b"1234567") + b"\0", "bad_length"),
    "payload cut": (lambda h: encode(refresh(h, payload=b"1234")), "bad_length"),
    "not COBS": (lambda _: b"\x20" + b"\x01" * 5 + b"\0", "bad_length"),
    "oversized": (lambda _: b"\x01" * (CODED_MAX + 1) + b"\0", "bad_length"),
    "very oversized": (lambda _: b"\x01" * 1000 + b"\0", "bad_length"),
    "another version": (lambda h: encode(refresh(h, version=VERSION + 1)), "bad_version"),
    "version 0": (lambda h: encode(refresh(h, version=0)), "bad_version"),
    "unknown type": (lambda h: encode(refresh(h, type=77)), "unknown_type"),
    "a board's type": (lambda h: encode(refresh(h, type=129)), "unknown_type"),
    "replayed": (lambda h: encode(refresh(h, seq=h.seq)), "replayed"),
    "far behind": (lambda h: encode(refresh(h, seq=h.seq + 0x8000)), "replayed"),
    "of another session": (
        lambda h: encode(refresh(h, payload=bytes(4) + refresh(h).payload[4:])), "foreign",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("bad", "counter"), BAD.values(), ids=BAD)
def test_a_bad_frame_is_dropped_counted_and_feeds_nothing(host, bad, counter):
    host.plan(1, {0: 300_000})
    host.wait(100_000)
    host.board.feed(bad(host))
    assert host.wait(60_000) == [(0, 1), (host.limits.watchdog_us, 0)]
    status = host.report()
    counted = {name: getattr(status, name) for name in COUNTERS if getattr(status, name)}
    assert counted == ({counter: 1} if counter else counted)
    assert sum(counted.values()) == 1
    assert status.faults == Fault.WATCHDOG


@pytest.mark.parametrize("ahead", [1, 0x7FFF])
def test_a_frame_ahead_is_taken_and_sequence_numbers_wrap(host, ahead):
    for host.seq in (0x7000, 0xE000, 0xFFFE - 1):
        host.arm()
    assert host.plan(1, {}).result == Result.OK
    assert host.plan(2, {}).result == Result.OK
    host.listen()
    host.board.feed(encode(refresh(host, seq=(host.seq + ahead) & 0xFFFF)))
    assert host.listen()[0].result == Result.STALE_PLAN


def test_frames_recorded_before_hello_are_worthless_after_it(host):
    """HELLO resets the sequence numbers; the session number is what keeps old frames out."""
    host.plan(1, {0: 300_000})
    recorded = encode(refresh(host, seq=3))
    host.hello()
    host.arm()
    host.listen()
    host.board.feed(recorded)
    assert host.listen()[0].result == Result.FOREIGN_SESSION
    assert host.wait(10_000) == []


def test_before_hello_there_is_no_session_to_guess(new_host):
    host = new_host(armed=False)
    host.board.power_cycle(1)
    host.session = 0
    assert host.arm().result == Result.FOREIGN_SESSION
    assert host.ping().state == State.SAFE


def test_bytes_may_come_one_by_one_and_after_garbage(host):
    host.listen()
    for byte in b"garbage\0\0" + encode_message(Ping(), 9, 5):
        host.board.feed(bytes([byte]))
    assert [(m.seq, m.t1_us) for m in host.listen()] == [(9, 5)]


def test_answers_that_the_line_cannot_carry_are_counted(host):
    host.listen()
    host.board.feed(b"".join(encode_message(Ping(), n, 0) for n in range(10)))
    assert [m.seq for m in host.listen()] == list(range(8))
    assert host.report().lost_acks == 2


def test_stamps_of_the_exchange(new_host):
    host = new_host(board={"clock_us": 1_000_000})
    host.wait(1234)
    ack = host.send(Ping(), t_us=55)
    assert (ack.t1_us, ack.t2_us) == (55, 1_001_234)


@pytest.mark.parametrize("before_us", [0, 1, 30_000, 75_000, 149_999, 150_001, 200_000])
def test_nothing_changes_when_the_clock_wraps(new_host, before_us):
    """The board's clock reaches 2^32 us in the middle of plans, rests, and the watchdog."""

    def fly(clock_us):
        host = new_host(board={"clock_us": clock_us % (1 << 32)})
        host.plan(1, {0: 60_000, 1: 40_000}, {1: 40_000})
        host.wait(60_000)
        host.plan(2, {5: 40_000, 1: 5_000})
        host.wait(75_000)
        host.plan(3, {0: 300_000}, age=20_000)
        host.wait(300_000)
        status = host.report()
        return host.edges, status.open_us, status.watchdog_trips, status.worst_late_us

    assert fly((1 << 32) - before_us) == fly(0)


def test_a_valve_at_rest_for_longer_than_half_a_wrap_still_opens(host):
    """36 minutes after it closed, the stamp of the closing would lie in the future."""
    host.plan(1, {0: 20_000})
    host.wait(200_000)
    for _ in range(36):
        host.board.skip(60_000_000)
        host.ping()
    now = host.board.now_us
    host.arm()
    host.plan(2, {0: 20_000, 1: 20_000})
    host.wait(50_000)
    assert host.edges_from(now) == [(now, 3), (now + 20_000, 0)]
    host.plan(3, {5: 20_000})
    host.wait(0)
    assert host.edges[-1].mask == 1 << 5


def test_every_edge_is_reported(host):
    host.plan(1, {v: 20_000 + 11_000 * v for v in (0, 1, 2, 3)}, {1: 5_000})
    host.wait(120_000)
    host.listen()
    found = [
        pair
        for m in host.heard
        if hasattr(m, "at_us")
        for pair in list(zip(m.at_us, m.mask, strict=True))[: m.count]
    ]
    assert found == [tuple(edge) for edge in host.edges]
    assert host.report().open_us[:4] == (20_000, 31_000, 42_000, 53_000)


# The codec by itself


@given(st.binary(max_size=253))
def test_cobs_round_trip_without_zeros(raw):
    coded = stuff(raw)
    assert 0 not in coded
    assert len(coded) == len(raw) + 1
    assert unstuff(coded) == raw


frames = st.builds(
    Frame,
    type=st.integers(0, 255),
    seq=st.integers(0, 0xFFFF),
    t_us=st.integers(0, 0xFFFFFFFF),
    payload=st.binary(max_size=PAYLOAD_MAX),
    version=st.integers(0, 255),
)


@given(frames)
def test_frame_round_trip(frame):
    assert decode(encode(frame)[:-1]) == frame


@given(st.lists(frames, max_size=5), st.data())
def test_a_stream_cut_anywhere_gives_the_same_frames(sent, data):
    stream = b"".join(map(encode, sent))
    decoder, found = Decoder(), []
    while stream:
        size = data.draw(st.integers(1, len(stream)))
        found += decoder.feed(stream[:size])
        stream = stream[size:]
    assert found == sent
    assert decoder.bad == {}


@given(frames, st.data())
def test_one_flipped_bit_is_always_found(frame, data):
    coded = bytearray(encode(frame)[:-1])
    at = data.draw(st.integers(0, len(coded) - 1))
    coded[at] ^= 1 << data.draw(st.integers(0, 7))
    if 0 in coded:
        return  # cut in two
    with pytest.raises(BadFrameError):
        decode(bytes(coded))


def test_a_field_outside_its_limits_is_not_sent():
    cmd = Cmd(1, 1, 0, 10_000_001, (0,) * 8, (0,) * 8)
    with pytest.raises(ValueError, match=r"Cmd\.ttl_us is 10000001, expected 1 to 10000000"):
        encode_message(cmd, 1, 0)
    with pytest.raises(ValueError, match="on_us"):
        encode_message(Cmd(1, 1, 0, 1, (-1,) + (0,) * 7, (0,) * 8), 1, 0)


@settings(max_examples=300)
@given(data=st.binary(max_size=300))
def test_no_bytes_break_the_decoder(data):
    Decoder().feed(data)
    assert Hello(1).pack() == b"\1\0\0\0"
