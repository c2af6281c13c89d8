"""`testbed poses`: what the cameras of a lab see, before anything is commanded."""

import math
import threading
from contextlib import nullcontext, suppress

import pytest

from ports import free_port
from testbed.cli import poses
from testbed.core.lab import MocapWire
from testbed.core.types import Pose
from testbed.mocap.exposure import Axes, Exposure, Sighting
from testbed.mocap.topic import encode_poses
from testbed.net.session import NoHostError, Publisher, dial, listen
from testbed.realtime.wall_clock import monotonic_ns

LOST = Sighting((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), tracked=False)


class Cameras:
    """A source with one look's worth of exposures."""

    def __init__(self, *exposures: Exposure) -> None:
        self.exposures, self.closed = list(exposures), False

    def poll(self):
        found, self.exposures = self.exposures, []
        return found

    def close(self):
        self.closed = True


def exposure(number=0, latency_ms=20.0, **bodies):
    now = monotonic_ns()
    return Exposure(number, now - round(1e6 * latency_ms), now, bodies)


@pytest.fixture
def look(testbed, monkeypatch):
    def call(*exposures, words=()):
        cameras = Cameras(*exposures)
        monkeypatch.setattr(poses, "datagrams", lambda wire: cameras)
        result = testbed("poses", "hold", "--for", "0.01", *words)
        assert cameras.closed
        return result

    return call


def test_a_vehicle_is_shown_in_the_frame_of_the_table(look):
    words = ["table.lab.mocap.origin=[0.1,-0.4]", "table.lab.mocap.turn_deg=90"]
    wire = MocapWire(origin=(0.1, -0.4), turn_deg=90.0)
    there = Axes(wire).to_cameras(Pose(1.5, -2.0, math.radians(30.0)))
    result = look(exposure(sat1=there), words=words)
    assert result.exit_code == 0
    assert "sat1 sat1 1.500 -2.000 30.0 1 20.0" in " ".join(result.stdout.split())


def test_a_name_of_the_cameras_is_mapped(look):
    there = Axes(MocapWire()).to_cameras(Pose(0.0, 0.0, 0.0))
    result = look(exposure(Body_1=there), words=["table.lab.mocap.bodies={sat1='Body_1'}"])
    assert result.exit_code == 0
    assert "Body_1 sat1 " in " ".join(result.stdout.split())


def test_a_vehicle_that_is_not_seen_is_named_and_so_are_the_others(look):
    there = Axes(MocapWire()).to_cameras(Pose(0.0, 0.0, 0.0))
    result = look(exposure(Body_1=there, sat1=LOST))
    assert result.exit_code == 1
    assert "sat1: the cameras do not track 'sat1'" in result.stderr
    shown = " ".join(result.stdout.split())
    assert "Body_1 - 0.000" in shown
    assert "sat1 sat1 - - - 0 " in shown


def test_no_frame_at_all(look):
    result = look()
    assert result.exit_code == 1
    assert "natnet at 127.0.0.1\n  expected  poses that arrive at 127.0.0.1" in result.stderr


def test_the_rate_is_of_the_last_second():
    seen = poses.Seen()
    seen.arrived_ns.extend(range(0, 3 * poses.SECOND_NS, poses.SECOND_NS // 100))
    assert seen.rate(3 * poses.SECOND_NS - 1) == 100


def test_an_interface_of_another_machine(testbed):
    result = testbed("poses", "hold", 'table.lab.mocap.interface="192.0.2.1"')
    assert result.exit_code == 2
    assert "[lab.mocap] interface = '192.0.2.1': " in result.stderr
    assert "expected an address of this machine" in result.stderr


@pytest.fixture
def where():
    return f"tcp/127.0.0.1:{free_port()}"


def speak(session, over):
    """Say where sat1 is, as cameras do that speak Zenoh."""
    publisher, x = (
        Publisher(session, "lab/table/pose"),
        Axes(MocapWire()).to_cameras(Pose(0.5, 0.0, 0.0)),
    )
    while not over.wait(0.02):
        now = monotonic_ns()
        publisher.send(encode_poses(1, now, now, {"sat1": (*x.position, *x.rotation)}))


@pytest.mark.parametrize("host", [True, False])
def test_poses_on_zenoh_come_by_the_host_or_in_its_absence(testbed, where, host):
    over = threading.Event()

    def cameras():
        while not over.is_set():
            with suppress(NoHostError), dial(where, 0.5) as session:
                speak(session, over)

    thread = threading.Thread(target=cameras)
    with listen(where) if host else nullcontext():
        thread.start()
        try:
            words = ["table.lab.mocap.system=zenoh", f'table.lab.network.endpoint="{where}"']
            result = testbed("poses", "hold", "--for", "3", *words)
        finally:
            over.set()
            thread.join()
    assert result.exit_code == 0, result.output
    assert "sat1 sat1 0.500 0.000 0.0 " in " ".join(result.stdout.split())


def test_no_message_on_zenoh_at_all(testbed, where):
    words = ["table.lab.mocap.system=zenoh", f'table.lab.network.endpoint="{where}"']
    result = testbed("poses", "hold", "--for", "0.1", *words)
    assert result.exit_code == 1
    assert f"zenoh on lab/table/pose\n  expected  poses that arrive at {where}" in result.stderr
