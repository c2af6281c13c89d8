"""The twin's stream as independent clients decode it, and as ours does: the same numbers."""

import math
import os
import socket
import subprocess
import sys
import threading
from contextlib import contextmanager

import pytest

from patience import wait_for
from ports import free_port
from testbed.core.lab import MocapWire
from testbed.core.types import Pose
from testbed.mocap.exposure import Axes, Sighting
from testbed.mocap.natnet import Described, MocapFrame, RigidBody
from testbed.mocap.natnet_client import NatNetClient
from testbed.mocap.natnet_server import NatNetAddress, NatNetServer
from testbed.realtime.wall_clock import monotonic_ns

WAYS = [((3, 1), None), ((4, 1), None), ((3, 1), "239.255.42.99"), ((4, 1), "239.255.42.99")]
NAMES = ["sat1", "sat2"]


def frame(number):
    angle = 0.01 * number
    now = monotonic_ns()
    bodies = tuple(
        RigidBody(
            k + 1, (number / 8, 0.125, k + math.sin(angle)),
            (0.0, math.sin(angle / 2), 0.0, math.cos(angle / 2)), 0.0005, number % 3 != 0,
        )
        for k in range(len(NAMES))
    )  # fmt: skip
    return MocapFrame(number, bodies, 1e-9 * now, now - 20_000_000, now - 1_000_000, now)


@contextmanager
def streaming(version, group):
    """A server that answers, and sends a frame every few milliseconds until the end."""
    address = NatNetAddress("127.0.0.1", *(free_port(socket.SOCK_DGRAM) for _ in range(2)), group)
    bodies = [Described(k + 1, name) for k, name in enumerate(NAMES)]
    sent, over = {}, threading.Event()
    with NatNetServer(address, version, bodies) as server:

        def run():
            number = 0
            while not over.wait(0.004):
                number += 1
                server.serve()
                sent[number] = frame(number)
                server.send(sent[number])

        thread = threading.Thread(target=run)
        thread.start()
        try:
            yield address, sent
        finally:
            over.set()
            thread.join()


def wire(address, version):
    return MocapWire(
        command_port=address.command_port, data_port=address.data_port, group=address.group,
        version=".".join(map(str, version)),
    )  # fmt: skip


def rounded(frame):
    return [
        (b.id, pytest.approx(b.position, abs=1e-6), pytest.approx(b.rotation, abs=1e-6), b.tracked)
        for b in frame.bodies
    ]


@pytest.mark.parametrize(("version", "group"), WAYS)
def test_the_natnet_package_and_ours_read_the_same(version, group):
    natnet = pytest.importorskip("natnet")
    with streaming(version, group) as (address, sent):
        ours = NatNetClient(wire(address, version))
        theirs = natnet.NatNetClient(
            "127.0.0.1", "127.0.0.1", use_multicast=group is not None,
            command_port=address.command_port, data_port=address.data_port,
        )  # fmt: skip
        heard, described, frames = {}, [], {}
        theirs.on_data_frame_received_event.handlers.append(
            lambda f: heard.setdefault(f.prefix.frame_number, f)
        )
        theirs.on_data_description_received_event.handlers.append(described.append)
        theirs.connect()
        theirs.request_modeldef()

        def enough():
            theirs.update_sync()
            for _ in ours.poll():
                frames[ours.newest.number] = ours.newest
            return described and len(heard.keys() & frames.keys()) > 20

        wait_for(enough)
        theirs.shutdown()
        ours.close()
    assert [(d.id_num, d.name) for d in described[-1].rigid_bodies] == [(1, "sat1"), (2, "sat2")]
    assert ours.names == {1: "sat1", 2: "sat2"}
    assert ours.info.version == version
    for number in heard.keys() & frames.keys():
        other = heard[number]
        read = [
            (b.id_num, tuple(b.pos), tuple(b.rot), b.tracking_valid) for b in other.rigid_bodies
        ]
        assert read == rounded(sent[number])
        mine = frames[number]
        assert [(b.id, b.position, b.rotation, b.tracked) for b in mine.bodies] == read
        assert other.suffix.stamp_camera_mid_exposure == mine.exposed == sent[number].exposed
        assert other.suffix.stamp_transmit == mine.sent


CHILD = """
import sys, threading, os
import motioncapture
m = motioncapture.connect("optitrack", {
    "hostname": "127.0.0.1", "interface_ip": "127.0.0.1", "port_command": sys.argv[1]})
for _ in range(20):
    m.waitForNextFrame()
    for name, body in m.rigidBodies.items():
        q = body.rotation
        print(name, *body.position, q.x, q.y, q.z, q.w, flush=True)
os._exit(0)
"""


@pytest.mark.parametrize(("version", "group"), WAYS)
def test_the_motioncapture_package_reads_the_same(version, group):
    pytest.importorskip("motioncapture")
    with streaming(version, group) as (address, sent):
        child = subprocess.run(
            [sys.executable, "-c", CHILD, str(address.command_port)],
            capture_output=True, text=True, timeout=60, check=False, env=dict(os.environ),
        )  # fmt: skip
    assert child.returncode == 0, child.stderr
    lines = [line.split() for line in child.stdout.splitlines() if line[:3] == "sat"]
    assert {words[0] for words in lines} == set(NAMES)
    for name, *words in lines:
        numbers = [float(word) for word in words]
        body = sent[round(8 * numbers[0])].bodies[NAMES.index(name)]
        assert numbers[:3] == pytest.approx(body.position, abs=1e-5)
        assert numbers[3:] == pytest.approx(body.rotation, abs=1e-5)


@pytest.mark.parametrize(("version", "group"), WAYS)
def test_latency_and_clock_are_read(version, group):
    with streaming(version, group) as (address, _):
        client = NatNetClient(wire(address, version))
        exposures = []

        def enough():
            exposures.extend(client.poll())
            return len(exposures) > 20 and client.clock.best.delay_ns > 0

        wait_for(enough)
        client.close()
    # one clock on one machine: the offset is nothing, give or take half the way there and back
    assert abs(client.clock.best.offset_ns) <= client.clock.best.delay_ns
    assert all(e.arrived_ns - e.exposed_ns > 15_000_000 for e in exposures[-5:])


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("pose", [Pose(1.0, 2.0, 0.3), Pose(-0.5, 0.1, -3.0), Pose(0, 0, 1.57)])
def test_there_and_back_between_cameras_and_table(up, pose):
    axes = Axes(MocapWire(up=up, origin=(0.4, -1.1), turn_deg=33.0))
    back = axes.to_table(axes.to_cameras(pose))
    assert (back.x, back.y, back.theta) == pytest.approx((pose.x, pose.y, pose.theta))


@pytest.mark.parametrize(
    ("up", "position", "rotation"),
    [  # the same body: 1 m to the right, 2 m up the table, turned a quarter to the left
        ("z", (1.0, 2.0, 0.1), (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))),
        ("y", (1.0, 0.1, -2.0), (0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5))),
    ],
)
def test_axes_by_hand(up, position, rotation):
    pose = Axes(MocapWire(up=up)).to_table(Sighting(position, rotation, tracked=True))
    assert (pose.x, pose.y, pose.theta) == pytest.approx((1.0, 2.0, math.pi / 2))
