"""A vehicle's process with plug-ins in the place of cameras and board."""

import json
import math
import os
import socket
import threading
from pathlib import Path

import pytest
from msgspec.structs import replace

from distribution import EXAMPLES, install
from firmware_interface.serial_thrusters import ThrustersError
from ports import free_port
from testbed.config import find, load
from testbed.core.lab import Lab, MocapWire, ThrusterWire
from testbed.core.types import Health, Pose, ValveCommand
from testbed.mocap import plugged
from testbed.mocap.exposure import Axes
from testbed.mocap.plugged import PluggedSource
from testbed.realtime.wall_clock import monotonic_ns
from testbed.rig.observers import NullObserver
from testbed.rig.twin import warm_up
from testbed.rig.wired import host
from testbed.rig.wired import thrusters as wired_thrusters
from testbed.rig.wired.host import WireRig
from testbed.rig.wired.thrusters import make_thrusters

ROOT = Path(__file__).resolve().parents[2]
NEAR = 1e-6  # two times that are the same [s]

# The example's board, on pins that are lines of a file.
PINS = """
from gpio_board import GpioBoard


class Chip:
    def __init__(self, path):
        self.file = open(path, "w")

    def write(self, pin, level):
        self.file.write(f"{pin} {int(level)}\\n")
        self.file.flush()

    def close(self):
        self.file.close()


def board(vehicle, clock, name: str, path: str):
    return GpioBoard(vehicle, clock, list(range(8)), 26, Chip(path + name))
"""


@pytest.fixture
def site(tmp_path, monkeypatch):
    """A folder with a package, which the vehicle's process finds, too."""
    folder = tmp_path / "site"
    folder.mkdir()
    (folder / "pins_in_a_file.py").write_text(PINS)
    groups = {
        "testbed.mocap": {"udp_json": "udp_json_cameras:UdpJsonCameras"},
        "testbed.thrusters": {"file": "pins_in_a_file:board"},
    }
    install(folder, "lab-of-ours", groups)
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(map(str, (ROOT, EXAMPLES, folder))))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return folder


def stream(port, pose, over):
    """Cameras that see sat1 a little noisily, 100 times a second."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        k = 0
        while not over.wait(0.01):
            k += 1
            seen = Axes(MocapWire()).to_cameras(replace(pose, x=pose.x + 1e-5 * math.sin(k)))
            bodies = {"sat1": [*seen.position, *seen.rotation]}
            data = json.dumps({"frame": k, "age": 0.0, "bodies": bodies})
            sender.sendto(data.encode(), ("127.0.0.1", port))


def test_a_vehicle_flies_with_both(site, tmp_path, monkeypatch):
    port, over = free_port(socket.SOCK_DGRAM), threading.Event()
    on_loopback = host.loopback

    def with_plug_ins(experiment, folder):
        there = on_loopback(experiment, folder)
        lab = there.table.lab
        mocap = replace(lab.mocap, system="udp_json", options={"port": port})
        pins = ThrusterWire("file", {"path": str(tmp_path / "pins-")})
        lab = replace(lab, mocap=mocap, thrusters=pins)
        return replace(there, table=replace(there.table, lab=lab))

    monkeypatch.setattr(host, "loopback", with_plug_ins)
    experiment = load(find("hold"), ["duration_s=1", "criteria={}"])
    warm_up(experiment)
    rig = WireRig(experiment, bench=True)
    pose = Pose(*experiment.vehicles["sat1"].start)
    cameras = threading.Thread(target=stream, args=(port, pose, over))
    cameras.start()
    try:
        ending = rig.fly(NullObserver())
    finally:
        over.set()
        cameras.join()
    assert (rig.red, ending.fault) == ([], None)
    assert ending.t == 1.0
    assert rig.results.boards["sat1"] == "[lab.thrusters] system = 'file'"
    levels = {}
    lines = (tmp_path / "pins-sat1").read_text().splitlines()
    for line in lines:
        pin, level = map(int, line.split())
        levels[pin] = level
    assert "26 1" in lines  # it floated
    assert any(line.endswith(" 1") for line in lines if not line.startswith("26"))  # and fired
    assert set(levels.values()) == {0}  # and all is shut
    assert len(list(rig.valves(since=-1.0))) > 1  # the log has the edges


# The two adapters


class Board:
    """A plug-in that notes what it is told, and fails when it is told to."""

    def __init__(self):
        self.told, self.fails = [], False

    def _note(self, *words):
        if self.fails:
            raise OSError("the cable")
        self.told.append(words)

    def apply(self, command):
        self._note("apply", command)

    def disarm(self):
        self._note("disarm")

    def land(self):
        self._note("land")

    def bearing(self, *, on):
        self._note("bearing", on)

    def close(self):
        self._note("close")

    def health(self):
        self._note("health")
        return Health(1e-9 * monotonic_ns(), 6e5, 0.0)

    def edges(self):
        return [(1e-9 * monotonic_ns(), 5), (1e-9 * monotonic_ns(), 0)]


@pytest.fixture
def plugged_in(monkeypatch):
    """Thrusters round such a board, and the board."""
    board = Board()
    monkeypatch.setattr(wired_thrusters.plugin, "load", lambda *words: lambda: board)
    model = load(find("hold")).vehicles["sat1"].model
    lab = Lab(thrusters=ThrusterWire("mine"))
    return make_thrusters(lab, "sat1", replace(model, command_delay_s=0.02), None), board


def test_plans_are_handed_over_in_the_time_of_the_machine_and_only_when_armed(plugged_in):
    thrusters, board = plugged_in
    plan = ValveCommand(3, 1.5, 1.6, (0,) * 8, (0,) * 8)
    with thrusters:
        thrusters.epoch_us = monotonic_ns() // 1000
        thrusters.apply(plan)
        thrusters.arm()
        thrusters.apply(plan)
    assert [words[0] for words in board.told] == ["health", "apply", "disarm", "close"]
    moved = board.told[1][1]
    assert moved.issued_at == pytest.approx(1e-6 * thrusters.epoch_us + 1.52, abs=NEAR)
    assert moved.valid_until == pytest.approx(1e-6 * thrusters.epoch_us + 1.62, abs=NEAR)
    assert [seq for seq, _ in thrusters.sent] == [3]


def test_a_board_that_fails_is_trouble_and_its_health_grows_old(plugged_in):
    thrusters, board = plugged_in
    with thrusters:
        thrusters.arm()
        board.fails = True
        thrusters.apply(ValveCommand(1, 0.0, 0.1, (0,) * 8, (0,) * 8))
        assert (
            thrusters.trouble.text == "[lab.thrusters] system = 'mine' failed: OSError: the cable"
        )
        one = thrusters.health()
        assert thrusters.health().silent_s > one.silent_s > 0.0
        thrusters.land()  # whatever it does, nothing more is raised
        with pytest.raises(ThrustersError, match="the cable"):
            thrusters.arm()
        with pytest.raises(ThrustersError, match="the cable"):
            thrusters.bearing(on=True)


def test_a_board_that_has_no_health_to_tell_is_refused(plugged_in):
    thrusters, board = plugged_in
    board.fails = True
    with pytest.raises(ThrustersError, match="the cable"), thrusters:
        pass


def test_it_floats_until_the_board_has_landed(plugged_in):
    thrusters, board = plugged_in
    with thrusters:
        assert not thrusters.floats
        thrusters.bearing(on=True)
        board.fails = True
        thrusters.land()
        assert thrusters.floats  # nothing has said that it is done
        board.fails = False
        thrusters.land()
        assert not thrusters.floats


def test_edges_are_of_the_run_and_say_whether_all_is_shut(plugged_in):
    thrusters, _ = plugged_in
    with thrusters:
        thrusters.epoch_us = monotonic_ns() // 1000
        assert thrusters.shut
        edges = thrusters.edges()
    assert [mask for _, mask in edges] == [5, 0, 5, 0]
    assert all(0.0 <= t < 60.0 for t, _ in edges)


def test_thrusters_that_cannot_be_made_are_refused(monkeypatch):
    model = load(find("hold")).vehicles["sat1"].model

    def dies():
        raise RuntimeError("no chip")

    monkeypatch.setattr(wired_thrusters.plugin, "load", lambda *words: dies)
    with pytest.raises(ThrustersError, match="cannot be used: RuntimeError: no chip"):
        make_thrusters(Lab(thrusters=ThrusterWire("mine")), "sat1", model, None)


def test_cameras_that_fail_have_no_poses_and_say_why(monkeypatch):
    class Cameras:
        def __init__(self, wire, rate: float = 1.0):
            assert wire.system == "mine"

        def poll(self):
            raise ValueError("half a frame")

        def close(self):
            pass

    monkeypatch.setattr(plugged.plugin, "load", lambda *words: Cameras)
    source = PluggedSource(MocapWire(system="mine", options={"rate": 2.0}))
    assert source.poll() == []
    assert source.complaint == "[lab.mocap] system = 'mine' failed: ValueError: half a frame"
    with pytest.raises(OSError, match=r"\[lab.mocap\] system = 'mine': .*rate"):
        PluggedSource(MocapWire(system="mine", options={"rate": "x"}))
