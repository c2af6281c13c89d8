"""Bytes for a pipe: their order, and what a full pipe leaves."""

import fcntl
import os

import numpy as np
import pytest

from testbed.logs.outbox import Outbox, widen


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


def test_a_pipe_gets_the_size_that_the_system_allows(pipe, monkeypatch):
    if not hasattr(fcntl, "F_SETPIPE_SZ"):
        pytest.skip("the system has no pipes of other sizes")
    reading, writing = pipe
    with os.fdopen(os.dup(writing), "wb") as file:
        widen(file, 512 * 1024)
        assert fcntl.fcntl(reading, fcntl.F_GETPIPE_SZ) == 512 * 1024
        change, asked = fcntl.fcntl, []

        def limited(pipe, command, size):
            asked.append(size)
            if size > 128 * 1024:
                raise PermissionError(1, "Operation not permitted")
            return change(pipe, command, size)

        monkeypatch.setattr(fcntl, "fcntl", limited)
        widen(file, 256 * 1024)
        widen(file, 4096 * 1024)  # neither is allowed: it stays as it is
        assert asked == [256 * 1024, 64 * 1024, 4096 * 1024, 1024 * 1024]
        monkeypatch.undo()
        assert fcntl.fcntl(reading, fcntl.F_GETPIPE_SZ) == 64 * 1024
        monkeypatch.delattr(fcntl, "F_SETPIPE_SZ")
        widen(file, 256 * 1024)
