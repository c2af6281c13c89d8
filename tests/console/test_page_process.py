"""The page's own process, without a browser: its place among other work."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from testbed.console.process import PRIORITY
from testbed.console.stopper import ahead
from testbed.realtime.scheduling import realtime_priority
from testbed.rig.wired import vehicle, wired_flight


@pytest.fixture
def page(tmp_path) -> Iterator["subprocess.Popen[str]"]:
    """The process of the page of a folder in which no run has begun."""
    one = subprocess.Popen(
        [sys.executable, "-m", "testbed.console.process", str(tmp_path), "127.0.0.1", "0"],
        stderr=subprocess.PIPE, text=True, env=os.environ | {"XDG_RUNTIME_DIR": str(tmp_path)},
    )  # fmt: skip
    assert one.stderr is not None
    assert one.stderr.readline().startswith("console: ")
    yield one
    one.kill()
    one.communicate()


def may_be_preferred() -> bool:
    with realtime_priority(PRIORITY) as allowed:
        return allowed


@pytest.mark.skipif(not may_be_preferred(), reason="the system allows no real-time priority")
def test_every_thread_of_the_page_runs_before_ordinary_work_and_behind_flights(page):
    threads = [int(one.name) for one in Path(f"/proc/{page.pid}/task").iterdir()]
    assert len(threads) > 3
    for thread in threads:
        assert os.sched_getscheduler(thread) == os.SCHED_FIFO
        assert os.sched_getparam(thread).sched_priority == PRIORITY
    assert min(wired_flight.PRIORITY, vehicle.PRIORITY) > PRIORITY


@pytest.mark.skipif(not may_be_preferred(), reason="the system allows no real-time priority")
def test_after_a_press_a_thread_is_where_it_was():
    with realtime_priority(PRIORITY):
        with ahead():
            assert os.sched_getparam(0).sched_priority > vehicle.PRIORITY
        assert os.sched_getscheduler(0) == os.SCHED_FIFO
        assert os.sched_getparam(0).sched_priority == PRIORITY
    assert os.sched_getscheduler(0) == os.SCHED_OTHER
