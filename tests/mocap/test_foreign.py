"""A motion-capture package that hangs or dies is started again; its poses come through."""

import os
import threading

import pytest

from testbed.core.lab import MocapWire
from testbed.mocap import foreign
from testbed.mocap.foreign import ForeignSource

GOOD = """
import os, struct, sys, time
import msgspec
for k in range(5):
    bodies = {"a": (1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0)}
    data = msgspec.msgpack.encode((k, time.monotonic_ns(), bodies))
    os.write(1, struct.pack("<I", len(data)) + data)
    time.sleep(0.001)
sys.stdin.read()
"""
DIES = GOOD.replace("sys.stdin.read()", "os.abort()")
HANGS = GOOD.replace("sys.stdin.read()", "time.sleep(1000)")


def poll_until(source, done):
    exposures = []
    for _ in range(3000):
        exposures += source.poll()
        if done(exposures):
            return exposures
        threading.Event().wait(0.01)
    pytest.fail("half a minute is enough")


@pytest.fixture
def make(tmp_path):
    sources = []

    def make(text, **wire):
        program = tmp_path / "program.py"
        program.write_text(text)
        sources.append(ForeignSource(MocapWire(system="vicon", **wire), program))
        return sources[-1]

    yield make
    for source in sources:
        pid = source._child.pid
        source.close()
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_poses_come_through(make):
    source = make(GOOD, delay_s=0.02)
    exposures = poll_until(source, lambda e: len(e) == 5)
    assert [e.number for e in exposures] == list(range(5))
    assert exposures[0].bodies["a"].position == (1.0, 2.0, 3.0)
    assert all(e.arrived_ns - e.exposed_ns == 20_000_000 for e in exposures)
    assert source.starts == 1


def test_one_that_dies_is_started_again(make, monkeypatch):
    monkeypatch.setattr(foreign, "AGAIN_NS", 0)
    source = make(DIES)
    poll_until(source, lambda e: source.starts == 3)


PRINTS = GOOD.replace("for k in", 'os.write(1, b"Error 42: no camera\\n" * 9)\nfor k in')


def test_what_a_package_prints_is_no_pose_and_no_end(make, monkeypatch):
    monkeypatch.setattr(foreign, "AGAIN_NS", 0)
    source = make(PRINTS)
    poll_until(source, lambda e: source.bad >= 2)
    assert source.starts >= 2


def test_a_package_that_is_not_there_is_named(monkeypatch):
    monkeypatch.setattr(foreign, "PACKAGE", "no_such_package")
    with pytest.raises(OSError, match=r"pip install .*\[mocap\]"):
        ForeignSource(MocapWire(system="vicon"))


def test_one_that_hangs_is_started_again(make, monkeypatch):
    monkeypatch.setattr(foreign, "SILENCE_NS", 50_000_000)
    source = make(HANGS)
    exposures = poll_until(source, lambda e: source.starts == 2 and len(e) >= 10)
    assert len(exposures) >= 10
