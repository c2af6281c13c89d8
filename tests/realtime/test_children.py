"""Processes end with their parent, whatever state they are in."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from patience import wait_for
from testbed.realtime import processes as children
from testbed.realtime.heartbeat import heartbeat
from testbed.realtime.processes import ChildError, ProcessGroup, hung_up

ROOT = Path(__file__).resolve().parents[2]
WAITS = "import sys; sys.stdin.read()"
IGNORES = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(1000)"
PARENT = """
import os, sys
from testbed.realtime.processes import ProcessGroup, hung_up
with ProcessGroup(grace_s=0.2) as children:
    pids = [children.start(f"c{k}", [sys.executable, "-c", p]) for k, p in enumerate(sys.argv[1:])]
    print(*pids, children.folder, flush=True)
    sys.stdin.read()
"""


def test_children_end_with_the_block():
    with ProcessGroup(grace_s=0.2) as children:
        pids = [
            children.start("polite", [sys.executable, "-c", WAITS]),
            children.start("deaf", [sys.executable, "-c", IGNORES]),
        ]
        children.check()
        folder = children.folder
    assert [pid for pid in pids if psutil.pid_exists(pid)] == []
    assert not folder.exists()


def test_the_process_that_ends_them_shows_that_it_lives():
    before = heartbeat().beats
    with ProcessGroup(grace_s=0.2) as children:
        children.start("deaf", [sys.executable, "-c", IGNORES])
    assert heartbeat().beats > before


def test_one_that_ends_on_its_own_is_reported_with_its_words():
    with ProcessGroup() as children:
        children.start("sat1", [sys.executable, "-c", "import sys; sys.exit('no board')"])
        child = psutil.Process(children.pid("sat1"))
        wait_for(lambda: child.status() == psutil.STATUS_ZOMBIE)
        with pytest.raises(ChildError, match=r"sat1 ended with code 1: no board"):
            children.check()


@pytest.mark.parametrize("stop", [False, True], ids=["running", "stopped"])
def test_children_of_a_killed_parent(stop):
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, WAITS, IGNORES],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    *pids, folder = parent.stdout.readline().split()
    tree = [psutil.Process(int(pid)) for pid in pids]
    tree += psutil.Process(parent.pid).children()
    if stop:
        for pid in pids:
            os.kill(int(pid), signal.SIGSTOP)
    parent.kill()
    parent.wait()
    parent.stdin.close()
    parent.stdout.close()
    _, alive = psutil.wait_procs(tree, timeout=60)
    assert alive == []
    assert not Path(folder).exists()


def test_a_stopped_guardian_does_not_keep_its_parent(monkeypatch):
    monkeypatch.setattr(children, "LEAVE_S", 0.1)
    with ProcessGroup() as some:
        guardian = some._guardian.pid
        os.kill(guardian, signal.SIGSTOP)
        os.waitid(os.P_PID, guardian, os.WSTOPPED)
    assert not psutil.pid_exists(guardian)


def test_a_closed_terminal_is_seen():
    leader, terminal = os.openpty()
    assert not hung_up(terminal)
    os.close(leader)
    assert hung_up(terminal)
    os.close(terminal)
