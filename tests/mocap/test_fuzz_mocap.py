"""Whatever comes on the cameras' ports is taken, or refused and counted; and poses come back after.

ABT_FUZZ is the number of datagrams, ABT_ROUND the seed; `make fuzz` sets them.
"""

import math
import os
import socket
import struct
from contextlib import suppress

import numpy as np
import pytest

from growth import growth
from testbed.core.lab import MocapWire
from testbed.mocap import natnet_client
from testbed.mocap.exposure import Exposure, Sighting
from testbed.mocap.natnet import (
    Described,
    MocapFrame,
    Packet,
    RigidBody,
    ServerInfo,
    encode_echo,
    encode_frame,
    encode_models,
    encode_server_info,
    packet,
)
from testbed.mocap.natnet_client import MOST, NatNetClient
from testbed.mocap.natnet_server import NatNetAddress, NatNetServer
from testbed.mocap.poses import MocapPoses
from testbed.realtime.wall_clock import WallClock, monotonic_ns

COUNT = int(os.environ.get("ABT_FUZZ", "9000")) // 3
ROUND = int(os.environ.get("ABT_ROUND", "0"))
GROWN = 100_000  # [bytes]
VERSION = (4, 1)
NAMES = [Described(1, "sat1"), Described(2, "sat2")]


def frame(number, now, x=0.5):
    bodies = tuple(
        RigidBody(k, (x + k, 0.1, 0.3), (0.0, 0.0, 0.0, 1.0), 0.0002, tracked=True) for k in (1, 2)
    )
    return encode_frame(MocapFrame(number, bodies, 1e-9 * now, now - 10**7, now, now), VERSION)


def greeting():
    info = ServerInfo("x", VERSION, 10**9, 1511, None)
    return [encode_server_info(info), encode_models(NAMES, VERSION)]


def spoilt(rng, data):
    sort = rng.random()
    if sort < 0.1:
        return rng.bytes(int(rng.integers(400)))
    broken = bytearray(data)
    if sort < 0.5:
        for _ in range(rng.integers(1, 4)):
            broken[rng.integers(len(broken))] = rng.integers(256)
    elif sort < 0.6:
        broken = broken[: rng.integers(len(broken))]
    else:  # whole words that a careless server may send
        word = struct.pack("<f", rng.choice([math.nan, math.inf, -math.inf, 1e30, -1.0, 0.0]))
        if sort < 0.8:
            word = struct.pack("<q", int(rng.choice([0, -1, 2**62, -(2**62), 2**31])))
        at = int(rng.integers(4, max(5, len(broken) - len(word))))
        broken[at : at + len(word)] = word
    return bytes(broken)


class Port:
    """What `_receive` finds."""

    def __init__(self):
        self.waiting = []

    def receive(self, one):
        return (*self.waiting.pop(0), "127.0.0.1") if self.waiting else None


@pytest.fixture
def port(monkeypatch):
    port = Port()
    monkeypatch.setattr(natnet_client, "receive", port.receive)
    return port


@pytest.fixture
def client():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as nobody:  # it may ask, and is ignored
        nobody.bind(("127.0.0.1", 0))
        client = NatNetClient(MocapWire(command_port=nobody.getsockname()[1]))
        yield client
        client.close()


def test_datagrams(port, client):
    rng = np.random.default_rng((ROUND, 1))
    wire = MocapWire(up="z")
    poses = MocapPoses(client, wire, WallClock(monotonic_ns()), "sat1")
    kinds = list(Packet)
    fed = 0

    def feed():
        nonlocal fed
        now = monotonic_ns()
        whole = [frame(fed, now), *greeting(), encode_echo(client._asked, now)]
        data = whole[rng.choice([0, 0, 0, 1, 2, 3])]
        if rng.random() < 0.7:
            data = spoilt(rng, data)
        if rng.random() < 0.05:
            data = packet(kinds[rng.integers(len(kinds))], rng.bytes(int(rng.integers(60))))
        port.waiting.append((data, now))
        fed += 1
        for sample in poses.samples():
            assert all(map(math.isfinite, (sample.captured_at, sample.x, sample.y, sample.theta)))
        poses.review()

    grown = growth(feed, COUNT, until_full=1200)  # of the latencies
    assert client.bad > 0.1 * fed
    assert poses.implausible > 0.001 * fed
    assert grown < GROWN

    found = []  # and when the server is itself again, so is the vehicle
    for k in range(600):
        now = monotonic_ns()
        # echoes, too: a wrong one is believed until it is forgotten, 32 right ones later
        said = *greeting(), encode_echo(client._asked, now), frame(k, now, 0.5 + 1e-5 * (k % 7))
        port.waiting += [(data, now) for data in said]
        client._ask_due = 0  # once a second otherwise
        found += poses.samples()
    assert len(found) > 100
    assert found[-1].x == pytest.approx(1.5, abs=1e-3)


def test_a_flood_does_not_keep_the_vehicle_from_flying(client, monkeypatch):
    monkeypatch.setattr(natnet_client, "receive", lambda one: (b"x", monotonic_ns(), "127.0.0.1"))
    assert client.poll() == []
    assert client.bad == MOST


def test_a_server_whose_clock_stands_still_is_refused(port, client):
    info = bytearray(encode_server_info(ServerInfo("x", VERSION, 1, 1511, None)))
    info[4 + 264 : 4 + 272] = bytes(8)
    port.waiting = [(bytes(info), 1)]
    client.poll()
    assert client.bad == 1
    assert client.info is None


def test_echoes_of_nothing_that_was_asked_do_not_set_the_clock(port, client):
    now = monotonic_ns()
    port.waiting = [(greeting()[0], now), (encode_echo(now - 5, 10**18), now)]
    client.poll()
    assert client.bad == 1
    assert client.clock.best is None


def described(*bodies):
    return encode_models([Described(k, name) for k, name in bodies], VERSION)


def test_a_body_without_description_does_not_hide_the_others(port, client):
    now = monotonic_ns()
    port.waiting = [(greeting()[0], now), (described((1, "sat1")), now)]
    client.poll()
    found = []
    for k in range(5):  # frames show bodies 1 and 2; the server is asked, and knows of 1 only
        port.waiting += [(frame(k, now), now), (described((1, "sat1")), now)]
        found += client.poll()
    assert len(found) == 4
    assert all(set(one.bodies) == {"sat1"} for one in found)
    port.waiting = [(described((1, "sat1"), (2, "late")), now), (frame(9, now), now)]
    assert set(client.poll()[0].bodies) == {"sat1", "late"}


def test_bodies_that_change_places_are_asked_for_again(port, client):
    now = monotonic_ns()
    port.waiting = [(data, now) for data in (*greeting(), frame(1, now))]
    assert len(client.poll()) == 1
    strange = MocapFrame(2, (RigidBody(3, (1, 1, 1), (0, 0, 0, 1), 0, True),), 0.0, now, now, now)
    port.waiting = [(encode_frame(strange, VERSION), now), (frame(3, now), now)]
    assert client.poll() == []  # until the server has said who is who
    port.waiting = [(described((1, "sat2"), (2, "sat1"), (3, "new")), now), (frame(4, now), now)]
    assert client.poll()[0].bodies["sat2"].position[0] == 1.5


def test_what_another_machine_sends_is_not_looked_at(client, monkeypatch):
    now = monotonic_ns()
    said = [(data, now, "10.0.0.9") for data in (*greeting(), frame(1, now))]
    monkeypatch.setattr(natnet_client, "receive", lambda one: said.pop(0) if said else None)
    assert client.poll() == []
    assert client.info is None
    assert client.complaint == "datagrams from other senders than the server: 3 from 10.0.0.9"


def test_a_server_of_another_time_is_named(port, client):
    info = ServerInfo("Motive", (2, 10), 10**9, 1511, None)
    port.waiting = [(encode_server_info(info), monotonic_ns())]
    client.poll()
    assert client.info is None
    assert "NatNet 2.10" in client.complaint


def test_an_interface_that_does_not_lead_there_is_named():
    client = NatNetClient(MocapWire(server="192.0.2.1"))
    client.poll()
    assert client.complaint == "none: 127.0.0.1 has no route to 192.0.2.1; 0.0.0.0 has"
    client.close()


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"server": "no.such.machine.invalid"}, "IPv4 address of the machine"),
        ({"server": "a b"}, "IPv4 address of the machine"),
        ({"interface": "::1"}, "interface = '::1'"),
        ({"interface": "203.0.113.7"}, "an address of this machine"),
        ({"group": "300.1.2.3"}, "such as 239.255.42.99"),
        ({"group": "10.0.0.1"}, "such as 239.255.42.99"),
        ({"group": "127.0.0.1"}, "such as 239.255.42.99"),
    ],
)
def test_an_address_that_is_none_is_named(wrong, words):
    with pytest.raises(OSError, match=r"lab\.mocap") as error:
        NatNetClient(MocapWire(**wrong))
    assert words in str(error.value)


class Scripted:
    """A source that says what it is told to."""

    def __init__(self):
        self.next = []

    def poll(self):
        said, self.next = self.next, []
        return said

    def close(self):
        pass


def sighting(x):
    return Sighting((x, 0.0, 0.1), (0.0, 0.0, 0.0, 1.0), tracked=True)


@pytest.mark.parametrize("first", [math.nan, math.inf, 1e5])
def test_a_first_pose_that_is_none_does_not_hide_the_true_ones(first):
    source, epoch = Scripted(), 10**12
    poses = MocapPoses(source, MocapWire(up="z"), WallClock(epoch), "sat1")
    for k, x in enumerate((first, 1.0, 1.00001)):
        at = epoch + k * 10**7
        source.next.append(Exposure(k, at, at + 10**7, {"sat1": sighting(x)}))
    assert [round(sample.x, 4) for sample in poses.samples()] == [1.0, 1.0]
    assert poses.implausible == 1


@pytest.mark.parametrize("exposed_s", [3600.0, -3600.0, 1e9])
def test_an_exposure_of_another_time_does_not_stop_the_watch(exposed_s):
    source, epoch = Scripted(), 10**12
    poses = MocapPoses(source, MocapWire(up="z"), WallClock(epoch), "sat1")
    for k in range(50):
        at = epoch + k * 10**7
        exposed = at + round(1e9 * exposed_s) if k == 20 else at
        source.next.append(Exposure(k, exposed, at + 10**7, {"sat1": sighting(0.01 * k)}))
    assert len(poses.samples()) == 49
    poses.review()
    assert poses.trouble is None or poses.trouble == "silent"  # the clock of this test stands still


def test_a_server_answers_rubbish_with_little():
    rng = np.random.default_rng((ROUND, 2))
    with NatNetServer(NatNetAddress("127.0.0.1", 0, 1511), VERSION, NAMES) as server:
        for _ in range(COUNT):
            kind, payload = int(rng.integers(200)), rng.bytes(int(rng.integers(100)))
            with suppress(ValueError):
                kind = Packet(kind)
            answer = server._answer(kind, payload, ("127.0.0.1", int(rng.integers(4))))
            assert answer is None or len(answer) < 400
        assert len(server._alive) <= 4
