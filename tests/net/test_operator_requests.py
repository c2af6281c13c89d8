"""Requests of an operator's page to a flight: replies, and invalid data."""

import socket
from pathlib import Path
from threading import Event, Thread

import pytest

from testbed.net.operator_requests import (
    Controls,
    ReadControls,
    Reply,
    RequestServer,
    Steer,
    Tune,
    ask,
    send,
    short_path,
)

NOW = Controls({"k": 1.0}, {"k": 1.0}, {"sat1": "law"}, {})


@pytest.fixture
def place(tmp_path):
    deep = tmp_path / ("deep" * 20) / ("deeper" * 10)  # a path that no socket may have
    deep.mkdir(parents=True)
    return deep / "1.sock"


def received(server):
    return [request for request, _ in server.received()]


def test_a_request_gets_its_reply(place):
    left = Event()
    with RequestServer(place) as server:

        def fly():
            while not left.wait(0.01):
                for request, reply in server.received():
                    reply(Reply(True, str(request.values), NOW))

        flight = Thread(target=fly)
        flight.start()
        answer = ask(place, Tune({"k": 2.0}), 20.0)
        left.set()
        flight.join()
    assert (answer.ok, answer.words, answer.controls) == (True, "{'k': 2.0}", NOW)
    assert not place.exists()


def test_only_the_same_user_can_open_the_socket(place):
    with RequestServer(place):
        assert place.stat().st_mode & 0o777 == 0o600


def test_a_stick_message_needs_no_reply(place):
    with RequestServer(place) as server:
        assert send(place, Steer("sat1", "velocity", "me", 5, 0.5))
        ((request, reply),) = server.received()
        reply(Reply(True, "", NOW))  # nobody waits for it
    assert (request.vehicle, request.x, request.stamp_ns) == ("sat1", 0.5, 5)


def test_without_a_flight_there_is_no_reply(place):
    assert not send(place, ReadControls())
    assert ask(place, ReadControls(), 0.01) is None
    with RequestServer(place):
        assert ask(place, ReadControls(), 0.01) is None  # it hangs


@pytest.mark.parametrize(
    "data", [b"", b"{}", b"\xff\xfe", b"[" * 5000,
             b'{"request":{"type":"Tune","values":{"k":"x"}}}',
             b'{"request":{"type":"Steer","vehicle":"sat1","mode":"fast","by":"me"}}']
)  # fmt: skip
def test_invalid_data_is_dropped(place, data):
    with RequestServer(place) as server, short_path(place) as name:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as client:
            client.sendto(data, name)
        assert send(place, ReadControls())
        assert received(server) == [ReadControls()]


def test_a_flood_does_not_keep_a_tick_busy(place):
    with RequestServer(place) as server:
        sent = sum(send(place, ReadControls()) for _ in range(1000))  # the kernel keeps some
        assert 0 < sent < 1000
        assert 0 < len(received(server)) <= 64


def test_the_socket_of_a_killed_flight_is_replaced(place):
    RequestServer(place)._socket.close()
    assert place.exists()
    assert not send(place, ReadControls())
    with RequestServer(place) as server:
        assert send(place, ReadControls())
        assert received(server) == [ReadControls()]


def test_no_descriptor_is_left_open(place):
    with RequestServer(place):
        send(place, ReadControls())
    before = sum(1 for _ in Path("/proc/self/fd").iterdir())
    with RequestServer(place) as server:
        for _ in range(5):
            send(place, ReadControls())
        received(server)
    assert sum(1 for _ in Path("/proc/self/fd").iterdir()) == before
