"""A flight's door: wishes in, answers out, and rubbish."""

import socket
from pathlib import Path
from threading import Event, Thread

import pytest

from testbed.net.door import Controls, Door, Look, Steer, Told, Tune, ask, short, tell

NOW = Controls({"k": 1.0}, {"k": 1.0}, {"sat1": "law"}, {})


@pytest.fixture
def place(tmp_path):
    deep = tmp_path / ("deep" * 20) / ("deeper" * 10)  # a path that no socket may have
    deep.mkdir(parents=True)
    return deep / "1.sock"


def heard(door):
    return [wish for wish, _ in door.heard()]


def test_a_wish_is_answered(place):
    left = Event()
    with Door(place) as door:

        def fly():
            while not left.wait(0.01):
                for wish, answer in door.heard():
                    answer(Told(True, str(wish.values), NOW))

        flight = Thread(target=fly)
        flight.start()
        told = ask(place, Tune({"k": 2.0}), 20.0)
        left.set()
        flight.join()
    assert (told.ok, told.words, told.controls) == (True, "{'k': 2.0}", NOW)
    assert not place.exists()


def test_only_the_same_user_may_knock(place):
    with Door(place):
        assert place.stat().st_mode & 0o777 == 0o600


def test_a_stick_needs_no_answer(place):
    with Door(place) as door:
        assert tell(place, Steer("sat1", "velocity", "me", 5, 0.5))
        ((wish, answer),) = door.heard()
        answer(Told(True, "", NOW))  # there is no one to tell
    assert (wish.vehicle, wish.x, wish.stamp_ns) == ("sat1", 0.5, 5)


def test_without_a_flight_there_is_no_answer(place):
    assert not tell(place, Look())
    assert ask(place, Look(), 0.01) is None
    with Door(place):
        assert ask(place, Look(), 0.01) is None  # it hangs


@pytest.mark.parametrize(
    "data", [b"", b"{}", b"\xff\xfe", b"[" * 5000, b'{"wish":{"type":"Tune","values":{"k":"x"}}}',
             b'{"wish":{"type":"Steer","vehicle":"sat1","mode":"fast","by":"me"}}']
)  # fmt: skip
def test_rubbish_is_dropped(place, data):
    with Door(place) as door, short(place) as name:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as knock:
            knock.sendto(data, name)
        assert tell(place, Look())
        assert heard(door) == [Look()]


def test_a_flood_does_not_keep_a_tick_busy(place):
    with Door(place) as door:
        sent = sum(tell(place, Look()) for _ in range(1000))  # the kernel keeps some of them
        assert 0 < sent < 1000
        assert 0 < len(heard(door)) <= 64


def test_the_socket_of_a_killed_flight_is_replaced(place):
    Door(place)._socket.close()
    assert place.exists()
    assert not tell(place, Look())
    with Door(place) as door:
        assert tell(place, Look())
        assert heard(door) == [Look()]


def test_no_descriptor_is_left_open(place):
    with Door(place):
        tell(place, Look())
    before = sum(1 for _ in Path("/proc/self/fd").iterdir())
    with Door(place) as door:
        for _ in range(5):
            tell(place, Look())
        heard(door)
    assert sum(1 for _ in Path("/proc/self/fd").iterdir()) == before
