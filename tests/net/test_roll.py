"""A vehicle starts at the order of the host it has enrolled with, and of no other."""

from types import SimpleNamespace

import msgspec
import pytest

from patience import wait_for
from ports import free_port
from testbed.net.commands import Accepted, Answer, Refused, Start
from testbed.net.keys import Keys
from testbed.net.roll_call import Enrolment, Roll, last_words
from testbed.net.session import NetworkError, ask, dial, listen
from testbed.realtime.wall_clock import monotonic_ns
from testbed.rig.wired.command_server import CommandServer

KEYS = Keys("lab")
BLIND = SimpleNamespace(ready=lambda: Refused("sees nothing"))  # a lookout
ORDER = KEYS.of("sat1", "order")


def ordered(session, start):
    """The vehicle's answer; the news that it listens takes a moment to reach all parties."""
    end = monotonic_ns() + 5 * 10**9
    while True:
        try:
            data = ask(session, ORDER, msgspec.msgpack.encode(start), wait_s=5.0)
        except NetworkError:
            if monotonic_ns() > end:
                raise
        else:
            return msgspec.msgpack.decode(data, type=Answer)


@pytest.fixture
def endpoint():
    return f"tcp/127.0.0.1:{free_port()}"


@pytest.fixture
def host(endpoint):
    with listen(endpoint) as session:
        yield session


def test_only_an_order_with_the_ticket_is_obeyed(host, endpoint):
    roll = Roll(host, KEYS, ["sat1"])
    with dial(endpoint) as vehicle, dial(endpoint) as stranger:
        enrolment = Enrolment(vehicle, KEYS, "sat1")
        assert roll.tickets == {"sat1": enrolment.ticket}
        commands = CommandServer(
            vehicle, KEYS, "sat1", "a board", BLIND, enrolment.ticket, lambda host_ns: host_ns
        )
        soon = monotonic_ns() + 10**9
        for ticket in (0, 1, enrolment.ticket ^ 1):
            answer = ordered(stranger, Start(7, soon, ticket))
            assert answer == Refused("the order to start is not from the host of this session")
        assert commands.starts.empty()
        assert commands.refused_orders == 3
        assert ordered(host, Start(8, soon, roll.tickets["sat1"])) == Accepted("a board")
        assert commands.starts.get_nowait().session == 8


def test_a_host_that_was_started_anew_is_given_the_ticket_again(host, endpoint, monkeypatch):
    first = Roll(host, KEYS, ["sat1"])
    with dial(endpoint) as vehicle:
        enrolment = Enrolment(vehicle, KEYS, "sat1")
        first.tickets.clear()
        enrolment.look()  # not yet
        assert first.tickets == {}
        later = monotonic_ns() + 2 * 10**9
        monkeypatch.setattr("testbed.net.roll_call.monotonic_ns", lambda: later)
        enrolment.look()
        wait_for(lambda: first.tickets == {"sat1": enrolment.ticket})


def test_what_is_no_ticket_is_not_kept(host, endpoint):
    roll = Roll(host, KEYS, ["sat1"])
    with (
        dial(endpoint) as stranger,
        pytest.raises(NetworkError, match="ValidationError"),
    ):
        ask(stranger, KEYS.of("sat1", "roll"), b"abc", wait_s=5.0)
    assert roll.tickets == roll.left == {}


def test_a_vehicle_that_ends_tells_its_host_why(host, endpoint):
    roll = Roll(host, KEYS, ["sat1"])
    with dial(endpoint) as vehicle:
        Enrolment(vehicle, KEYS, "sat1")
        with pytest.raises(OSError, match="unplugged"), last_words(vehicle, KEYS, "sat1"):
            raise OSError("the board is unplugged")
        assert roll.tickets == {}
        assert roll.left == {"sat1": "the board is unplugged"}
        assert not roll.stopped
        Enrolment(vehicle, KEYS, "sat1")  # it was started again
        assert roll.left == {}
