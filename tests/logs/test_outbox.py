"""Bytes for a pipe: their order, and what a full pipe leaves."""

import os

import numpy as np
import pytest

from testbed.logs.outbox import Outbox


@pytest.fixture
def pipe():
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    yield reading, writing
    for end in (reading, writing):
        os.close(end)


def test_small_and_large_pieces_leave_in_order_through_a_pipe_that_is_often_full(pipe):
    reading, writing = pipe
    rng, box, sent, received = np.random.default_rng(3), Outbox(), b"", b""
    for _ in range(200):
        data = rng.bytes(int(rng.choice((0, 1, 5, 700, 40_000))))
        sent += data
        if rng.random() < 0.5:
            box.add(data)
        else:
            box.add_memory(memoryview(data))
        if rng.random() < 0.3:
            before = box.size
            assert box.write_to(writing) == before - box.size
        if rng.random() < 0.4 and len(received) + box.size < len(sent):
            received += os.read(reading, 30_000)
        assert len(received) + box.size <= len(sent)
    os.set_blocking(reading, False)
    while box.size:
        assert box.write_to(writing) or len(received) + box.size < len(sent)
        received += os.read(reading, 30_000)
    assert box.write_to(writing) == 0
    while len(received) < len(sent):
        received += os.read(reading, 30_000)
    assert received == sent


def test_more_pieces_than_the_system_takes_at_once(pipe):
    reading, writing = pipe
    box = Outbox()
    for k in range(3000):
        box.add(b"<")
        box.add_memory(memoryview(bytes([k % 251])))
    assert box.write_to(writing) == 6000
    data = os.read(reading, 10_000)
    assert data[::2] == b"<" * 3000
    assert data[1::2] == bytes(k % 251 for k in range(3000))


def test_a_full_pipe_keeps_the_rest(pipe):
    _, writing = pipe
    box = Outbox()
    box.add_memory(memoryview(bytes(10_000_000)))
    taken = box.write_to(writing)
    assert 0 < taken < 10_000_000
    assert box.size == 10_000_000 - taken
    assert box.write_to(writing) == 0
    box.clear()
    assert box.size == 0
    assert box.write_to(writing) == 0
