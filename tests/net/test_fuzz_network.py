"""Whatever comes over the network is taken, or refused and counted. Nothing crashes or grows.

ABT_FUZZ is the number of messages, ABT_ROUND the seed; `make fuzz` sets them.
"""

import math
import os
import socket
import struct
from contextlib import suppress
from types import SimpleNamespace

import msgspec
import numpy as np
import psutil
import pytest

from growth import growth
from ports import free_port
from testbed.config import find, load
from testbed.core.codes import FaultReport
from testbed.core.records.layout import HEADER
from testbed.core.types import (
    Accel,
    Demand,
    Health,
    Inputs,
    LawMessage,
    Pose,
    PoseSample,
    Reference,
    State,
    Trajectory,
    Twist,
)
from testbed.mocap.topic import MOST_BODIES, PoseTopic, encode_poses
from testbed.net.access import ACCESS, read_access
from testbed.net.commands import Counts, Ended, Lease, Order, Refused, Start, Stop
from testbed.net.credentials import CredentialsError, read_credentials
from testbed.net.envelope import SCHEMA, Acceptance, Inbox, Outbox
from testbed.net.keys import Keys
from testbed.net.payload import body_of, open_message, open_setpoint, open_state
from testbed.net.session import LARGEST, NetworkError, answer_to, ask, dial, listen
from testbed.realtime.wall_clock import monotonic_ns
from testbed.rig.chain import make_agent
from testbed.rig.wired.command_server import CommandServer
from testbed.rig.wired.truth import newest_truth

BLIND = SimpleNamespace(ready=lambda: Refused("sees nothing"))  # a lookout

COUNT = int(os.environ.get("ABT_FUZZ", "9000")) // 3
ROUND = int(os.environ.get("ABT_ROUND", "0"))
RUN, NOW, LATE = 7, 50.0, 0.2
GROWN = 100_000  # [bytes] that are no leak: caches, and a few objects of the test

pack, unpack = msgspec.msgpack.encode, msgspec.msgpack.decode


def state(t=NOW):
    return State(t, Pose(1.0, 2.0, 3.0), Twist(0.1, 0.0, 0.2), Accel(0, 0, 0), 0.02, 0)


def reference(t=NOW):
    return Reference(t, Pose(1, 2, 3), Twist(0, 0, 0), Accel(0, 0, 0))


COUNTS = Counts({"taken": 3}, {}, {}, 0, 0, 12.0, None)
MESSAGES = {
    "state": (open_state, state()),
    "trajectory": (open_setpoint, Trajectory((reference(), reference(NOW + 0.1)), NOW + 0.3)),
    "demand": (open_setpoint, Demand(NOW, 0.1, 0.2, 0.3, 0.0, 0.0, NOW + 0.2)),
    "message": (open_message, LawMessage(NOW, (1.0, 2.0, 3.0))),
    "lease": (msgspec.msgpack.Decoder(Lease).decode, Lease()),
    "event": (
        msgspec.msgpack.Decoder(Ended).decode,
        Ended(NOW, FaultReport("leak", "a fault", "sat1"), COUNTS),
    ),
}
EVIL = [
    math.nan, math.inf, -math.inf, 1e300, -1e18, 0, -1, 2**63, 2**64 - 1, -(2**63), None, True, "",
    "\ud7ff" * 50, b"\xff" * 50, [], {}, [[]], {"": {}}, [1.0] * 300,
]  # fmt: skip

REALS = [math.nan, math.inf, -math.inf, 1e300, -1e18, 0.0, -1.0]
WHOLE = [0, 1, 2**31, 2**32 - 1]
WORDS = [struct.pack("<d", x) for x in REALS] + [struct.pack("<I", n) for n in WHOLE]
EVIL_NUMBERS = [[0, 8, 2**64 - 1], [0, 2**63, 2**64 - 1], REALS, REALS, WHOLE]  # of an envelope


def leaves(tree, path=()):
    """Every place in a tree."""
    found = [path] if path else []
    if isinstance(tree, dict):
        for key in tree:
            found += leaves(tree[key], (*path, key))
    elif isinstance(tree, list):
        for k, one in enumerate(tree):
            found += leaves(one, (*path, k))
    return found


def spoilt(rng, data):
    """A message with something wrong: a bit, an end, a value, or everything."""
    sort = rng.random()
    if sort < 0.15:
        return rng.bytes(int(rng.integers(200)))
    if sort < 0.4:
        broken = bytearray(data)
        for _ in range(rng.integers(1, 4)):
            broken[rng.integers(len(broken))] ^= 1 << int(rng.integers(8))
        return bytes(broken)
    if sort < 0.55:
        return data[: rng.integers(len(data))] + rng.bytes(int(rng.integers(4)))
    if data[:4] == HEADER:
        broken = bytearray(data)
        at = int(rng.integers(1, len(data) // 4)) * 4
        word = WORDS[rng.integers(len(WORDS))]
        broken[at : at + len(word)] = word
        return bytes(broken)
    tree = unpack(data)
    places = leaves(tree)
    if not places:
        return pack(EVIL[rng.integers(len(EVIL))])
    *way, last = places[rng.integers(len(places))]
    node = tree
    for key in way:
        node = node[key]
    if rng.random() < 0.2 and isinstance(node, dict):
        del node[last]
    else:
        node[last] = EVIL[rng.integers(len(EVIL))]
    return pack(tree)


def sealed(rng, body, seq):
    """In an envelope that is whole, most of the time."""
    head = [RUN, seq, NOW, NOW + 0.3, SCHEMA]
    if rng.random() < 0.2:
        k = rng.integers(5)
        head[k] = EVIL_NUMBERS[k][rng.integers(len(EVIL_NUMBERS[k]))]
    return HEADER + struct.pack("<QQddI4x", *head) + body


def numbers(value):
    """All numbers in a message."""
    if isinstance(value, dict):
        return [x for one in value.values() for x in numbers(one)]
    if isinstance(value, list | tuple):
        return [x for one in value for x in numbers(one)]
    return [value] if isinstance(value, float) else []


@pytest.mark.parametrize("kind", MESSAGES)
def test_spoilt_messages_are_dropped(kind):
    rng = np.random.default_rng((ROUND, len(kind)))
    decode, whole = MESSAGES[kind]
    body, fed = body_of(whole), [0]
    box = Inbox(decode, RUN, LATE)

    def feed():
        fed[0] += 1
        bad = spoilt(rng, body) if rng.random() < 0.9 else body
        verdict = box.take(sealed(rng, bad, fed[0]), NOW + 0.01)
        if verdict is Acceptance.TAKEN and isinstance(
            box.newest, State | Trajectory | Demand | LawMessage
        ):
            assert all(
                abs(x) < 1e9 for x in numbers(msgspec.to_builtins(box.newest, enc_hook=tuple))
            )
            assert not isinstance(box.newest, Trajectory) or box.newest.references
        if box._seq > 10 * COUNT:  # a number that is far ahead was believed: of this sender it is
            box._seq = 0

    grown = growth(feed, COUNT)
    assert sum(box.counts.values()) == fed[0]
    assert box.counts[Acceptance.TAKEN] > 0
    if kind != "lease":  # of which nothing can be wrong but the envelope
        assert box.counts[Acceptance.GARBLED] > 0.3 * fed[0]
    assert grown < GROWN


@pytest.mark.parametrize(
    ("decode", "message"),
    [
        (open_state, msgspec.structs.replace(state(), pose=Pose(math.nan, 0, 0))),
        (open_state, msgspec.structs.replace(state(), pose_age=math.inf)),
        (open_setpoint, Trajectory((), NOW + 1)),
        (open_setpoint, Trajectory((reference(math.nan),), NOW + 1)),
        (open_setpoint, Trajectory((reference(),), math.inf)),
        (open_setpoint, Demand(NOW, math.nan, 0, 0, 0, 0, NOW + 1)),
        (open_setpoint, Demand(NOW, 0, 0, 0, 0, 0, math.inf)),
        (open_message, LawMessage(NOW, (math.inf,))),
    ],
)
def test_numbers_that_are_none_do_not_come_in(decode, message):
    box = Inbox(decode, RUN, LATE)
    assert box.take(Outbox(RUN).seal(message, NOW, NOW + 0.3), NOW) is Acceptance.GARBLED
    assert box.newest is None


def test_a_message_for_ever_is_none():
    for until in (math.inf, NOW + 61.0):
        box = Inbox(open_state, RUN, LATE)
        assert box.take(Outbox(RUN).seal(state(), NOW, until), NOW) is Acceptance.GARBLED


def test_a_vehicle_flies_on_whatever_it_is_told():
    rng = np.random.default_rng((ROUND, 99))
    experiment = load(find("zhang2023_table"))
    commands, others = Inbox(open_setpoint, RUN, 1e6), Inbox(open_state, RUN, 1e6)
    x, y, theta = experiment.vehicles["sat1"].start
    bodies = [body_of(MESSAGES[kind][1]) for kind in ("trajectory", "demand")]
    fired = 0
    for k in range(1, min(COUNT, 3000)):
        t = 0.1 * k
        if k % 40 == 1:  # the one before is braking by now
            agent = make_agent(experiment, "sat1")
        commands.take(sealed(rng, spoilt(rng, bodies[k % 2]), k), NOW)
        others.take(sealed(rng, spoilt(rng, body_of(state())), k), NOW)
        commands._seq = others._seq = 0
        neighbours = {"sat2": others.newest} if others.newest is not None else {}
        samples = (PoseSample(t - 0.02, x, y, theta),)
        inputs = Inputs(t, True, samples, commands.newest, neighbours, Health(t, 4e5, 2e7))
        out = agent.step(inputs)
        assert all(0 <= on <= 100_001 for on in out.command.on_us)
        fired += sum(out.command.on_us)
        assert all(
            math.isfinite(v)
            for v in (out.commanded_wrench.fx, out.commanded_wrench.fy, out.commanded_wrench.tau)
        )
    assert fired > 0


TICKET = 77


class NoSession:
    """Of Zenoh, for those who only declare."""

    def declare_queryable(self, *_, **__):
        return None

    declare_subscriber = declare_queryable


def test_spoilt_orders_are_refused():
    rng = np.random.default_rng((ROUND, 1))
    now = monotonic_ns()
    whole = [pack(Start(7, now, TICKET)), pack(Stop("enough"))]
    commands = CommandServer(
        NoSession(), Keys("lab"), "sat1", "a board", BLIND, TICKET, lambda ns: ns
    )
    fed = answered = 0

    def feed():
        nonlocal fed, answered
        fed += 1
        commands._flying.clear()
        try:
            commands._order(spoilt(rng, whole[fed % 2]))
            answered += 1
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
            pass  # told to the asker, see `answer_to`
        while not commands.starts.empty():
            assert abs(commands.starts.get().epoch_ns - monotonic_ns()) < 40e9

    assert growth(feed, COUNT) < GROWN
    assert 0 < answered < fed
    assert commands.refused_orders >= fed - answered > 0.3 * fed


@pytest.mark.parametrize("ahead_s", [-2.0, 31.0, 1e9, -1e9])
def test_an_order_to_start_at_another_time_is_refused(ahead_s):
    commands = CommandServer(
        NoSession(), Keys("lab"), "sat1", "a board", BLIND, TICKET, lambda ns: ns
    )
    when = max(0, monotonic_ns() + round(1e9 * ahead_s))
    assert b"expected 0 to 30 s" in commands._order(pack(Start(7, when, TICKET)))
    assert commands.starts.empty()
    assert b"Accepted" in commands._order(pack(Start(7, monotonic_ns() + 10**9, TICKET)))


def test_spoilt_truth_is_dropped():
    rng = np.random.default_rng((ROUND, 2))
    whole = pack((5, {"sat1": [0.0] * 6, "sat2": [1.0] * 6}))
    bad = good = 0

    def feed():
        nonlocal bad, good
        states = newest_truth([(1, spoilt(rng, whole))])
        bad += states is None
        if states is not None:
            good += 1
            assert all(len(row) == 6 and np.isfinite(row).all() for row in states.values())

    assert growth(feed, COUNT) < GROWN
    assert bad > 0.3 * COUNT
    assert good > 0


def test_poses_of_a_topic():
    rng = np.random.default_rng((ROUND, 3))
    topic, fed = PoseTopic(NoSession(), "lab/table/pose"), 0
    whole = encode_poses(5, 10**9, 10**9, {"a": (1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0)})

    def feed():
        nonlocal fed
        fed += 1
        data = spoilt(rng, whole)
        if rng.random() < 0.2:  # ever new names
            name = rng.bytes(8).hex()
            data = encode_poses(1, 10**9, 10**9, {name: (0.0,) * 7})
        topic._subscriber._waiting.append((monotonic_ns(), data))
        topic.poll()
        assert len(topic._known) <= MOST_BODIES

    for _ in range(max(0, 2000 - COUNT)):
        feed()  # until the names are full
    assert growth(feed, COUNT) < GROWN
    assert topic.bad > 0.3 * fed


def test_key_folders(tmp_path):
    rng = np.random.default_rng((ROUND, 4))
    credentials = (
        b'{"lab": "lab", "endpoint": "tls/127.0.0.1:7450", "role": "host", "name": "host",'
        b' "fingerprint": "AA", "expires": "2030-01-01T00:00:00+00:00"}'
    )
    access = (
        b'lab = "lab"\nendpoint = "tls/127.0.0.1:7450"\n\n[[party]]\nrole = "vehicle"\n'
        b'name = "sat1"\nfingerprint = "AA"\nexpires = "2030-01-01T00:00:00+00:00"\n'
    )
    for name in ("authority.pem", "certificate.pem", "private.key"):
        (tmp_path / name).write_bytes(b"")
        (tmp_path / name).chmod(0o600)
    refused = 0
    for _ in range(COUNT // 3):
        for name, whole, read in (
            ("credentials.json", credentials, read_credentials), (ACCESS, access, read_access),
        ):  # fmt: skip
            broken = bytearray(whole)
            for _ in range(rng.integers(1, 5)):
                at = int(rng.integers(len(broken)))
                broken[at : at + int(rng.integers(3))] = rng.bytes(int(rng.integers(3)))
            (tmp_path / name).write_bytes(bytes(broken))
            try:
                read(tmp_path)
            except CredentialsError:
                refused += 1
    assert refused > COUNT / 20


# Zenoh itself


def test_rubbish_at_the_hosts_port_keeps_no_vehicle_out():
    rng = np.random.default_rng((ROUND, 5))
    port = free_port()
    with listen(f"tcp/127.0.0.1:{port}") as host:
        kept = answer_to(host, "lab/host/clock", lambda _: b"12345678")
        for number in range(60):
            with socket.create_connection(("127.0.0.1", port), timeout=5.0) as one:
                data = rng.bytes(int(rng.integers(1, 2000)))
                if number % 2:  # framed as Zenoh frames
                    data = struct.pack("<H", len(data)) + data
                with suppress(OSError):
                    one.sendall(data)
        with dial(f"tcp/127.0.0.1:{port}", 5.0) as session:
            assert ask(session, "lab/host/clock", wait_s=5.0) == b"12345678"
        del kept


def test_a_message_that_is_too_large_is_not_taken_and_takes_no_memory():
    port = free_port()
    heard = []
    with listen(f"tcp/127.0.0.1:{port}") as host:
        kept = answer_to(host, "lab/echo", lambda data: heard.append(len(data)) or b"heard")
        rss = psutil.Process().memory_info().rss
        for _ in range(20):
            with (
                dial(f"tcp/127.0.0.1:{port}", 5.0) as session,
                pytest.raises(NetworkError),
            ):
                ask(session, "lab/echo", bytes(16 * LARGEST), wait_s=0.1)
        grown = psutil.Process().memory_info().rss - rss
        with dial(f"tcp/127.0.0.1:{port}", 5.0) as session:
            assert ask(session, "lab/echo", bytes(1000), wait_s=5.0) == b"heard"
        del kept
    assert heard == [1000]
    assert grown < 60e6  # [bytes] of 84 MB that were sent; the sender's own buffers are among them


def test_orders_are_a_union_that_says_what_it_is():
    assert unpack(pack(Stop("x")), type=Order) == Stop("x")
