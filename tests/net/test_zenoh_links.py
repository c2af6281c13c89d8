"""Links over a real Zenoh session on loopback."""

from contextlib import ExitStack

import pytest

from patience import wait_for
from ports import free_port
from testbed.core.lab import Lab
from testbed.core.types import Accel, Demand, LawMessage, Pose, State, Twist
from testbed.mocap.topic import PoseTopic, encode_poses
from testbed.net.envelope import Acceptance
from testbed.net.keys import Keys
from testbed.net.links import (
    LocalMessages,
    Party,
    ZenohHostLink,
    ZenohVehicleLink,
    host_states,
)
from testbed.net.session import NetworkError, Publisher, answer_to, ask, dial, listen
from testbed.realtime.wall_clock import WallClock, monotonic_ns
from testbed.rig.wired import host_contact
from testbed.rig.wired.host_contact import VehicleError, await_alone


def endpoint():
    return f"tcp/127.0.0.1:{free_port()}"


def state(t):
    return State(t, Pose(1, 2, 3), Twist(0, 0, 0), Accel(0, 0, 0), 0.02, 0)


@pytest.fixture
def sessions():
    """The host's, and two vehicles'."""
    where = endpoint()
    with ExitStack() as stack:
        yield [
            stack.enter_context(listen(where)),
            *(stack.enter_context(dial(where)) for _ in range(2)),
        ]


@pytest.fixture
def party(sessions):
    clock = WallClock(monotonic_ns())

    def make(k, name, run=5):
        return Party(sessions[k], Lab(), run, clock, 0, name)

    return make


def test_states_and_setpoints_get_across(party):
    names = ["a", "b"]
    host = party(0, "host")
    states, board = host_states(host, names), LocalMessages()
    to_a = ZenohHostLink(host, "a", states, board)
    a, b = (ZenohVehicleLink(party(k + 1, n), names) for k, n in enumerate(names))

    def exchanged():
        now = host.clock.now
        a.publish(state(now))
        b.publish(state(now))
        a.broadcast(LawMessage(now, (1.0, 2.0)))
        to_a.publish(Demand(now, 1, 2, 3, 0, 0, now + 0.3))
        return (
            a.setpoint() and to_a.own() and to_a.neighbours() and b.neighbours() and b.messages()
        )  # vehicles hear each other through the host

    wait_for(exchanged)
    assert isinstance(a.setpoint(), Demand)
    assert b.setpoint() is None
    assert set(to_a.neighbours()) == {"b"}
    assert set(b.neighbours()) == {"a"}
    assert b.messages()["a"].values == (1.0, 2.0)
    assert a.setpoints.inbox.counts[Acceptance.FOREIGN] == 0


def test_setpoints_of_another_run_are_refused(party):
    names = ["a"]
    other = party(0, "host", run=6)
    link = ZenohHostLink(other, "a", host_states(other, names), LocalMessages())
    a = ZenohVehicleLink(party(1, "a"), ())

    def refused():
        now = other.clock.now
        link.publish(Demand(now, 1, 2, 3, 0, 0, now + 0.3))
        return a.setpoint() or a.setpoints.inbox.counts[Acceptance.FOREIGN] > 3

    wait_for(refused)
    assert a.setpoint() is None


def test_questions_are_answered_or_it_is_said_why_not(sessions):
    host, vehicle, _ = sessions

    def fails(asked):
        raise ValueError("no such thing")

    kept = [answer_to(host, "k/echo", lambda asked: asked + b"!"), answer_to(host, "k/bad", fails)]
    assert ask(vehicle, "k/echo", b"hello") == b"hello!"
    with pytest.raises(NetworkError, match="ValueError: no such thing"):
        ask(vehicle, "k/bad")
    with pytest.raises(NetworkError, match="no party is there"):
        ask(vehicle, "k/nothing", wait_s=0.2)
    del kept


def test_a_lost_token_is_noticed(sessions):
    host, vehicle, _ = sessions
    key = Keys("lab").of("a", "alive")
    token = vehicle.liveliness().declare_token(key)
    wait_for(lambda: list(host.liveliness().get(key, timeout=1.0)))
    token.undeclare()
    wait_for(lambda: not list(host.liveliness().get(key, timeout=1.0)))


def test_no_party_there(tmp_path):
    with pytest.raises(NetworkError, match="no host answers at"):
        dial(endpoint(), 0.0)


def test_an_address_that_is_taken():
    where = endpoint()
    with listen(where), pytest.raises(NetworkError, match="cannot listen on"):
        listen(where)


def test_poses_from_a_topic(sessions):
    host, vehicle, _ = sessions
    topic = PoseTopic(vehicle, "lab/table/pose")
    publisher, exposures, number = Publisher(host, "lab/table/pose"), [], 0

    def enough():
        nonlocal number
        number += 1
        bodies = {"a": (1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0)}
        if number % 2:
            bodies["b"] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
        now = monotonic_ns()
        publisher.send(encode_poses(number, now - 10**7, now, bodies))
        exposures.extend(topic.poll())
        return len(exposures) > 5

    wait_for(enough)
    last = exposures[-1]
    assert last.bodies["a"].position == (1.0, 2.0, 3.0)
    assert last.bodies["b"].tracked == bool(last.number % 2)
    assert last.arrived_ns - last.exposed_ns >= 10**7 - 10**6
    publisher.send(b"garbage")
    wait_for(lambda: topic.poll() is None or topic.bad == 1)


def test_a_second_vehicle_of_the_same_name_is_refused_until_the_first_is_gone(
    sessions, monkeypatch
):
    monkeypatch.setattr(host_contact, "ALONE_NS", 0)
    keys = Keys("lab")
    token = sessions[1].liveliness().declare_token(keys.of("sat1", "alive"))
    wait_for(lambda: list(sessions[0].liveliness().get(keys.of("sat1", "alive"))))
    with pytest.raises(VehicleError, match="another agent flies as sat1"):
        await_alone(sessions[2], keys, "sat1")
    await_alone(sessions[2], keys, "sat2")
    monkeypatch.setattr(host_contact, "ALONE_NS", 60_000_000_000)
    token.undeclare()
    await_alone(sessions[2], keys, "sat1")
