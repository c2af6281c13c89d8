"""A slow law is told from a busy machine."""

import os
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest
from msgspec.structs import replace

from controllers.own_law import OwnLawParams
from testbed.config import find, load
from testbed.core.codes import FaultId
from testbed.realtime.law_watch import MANY, LawWatch, TimedLaw
from testbed.realtime.wall_clock import monotonic_ns, sleep_until_ns
from testbed.rig.chain import watched

WORK_S = 0.02  # of a processor per call [s]


@pytest.fixture
def crowded():
    """One core for this process and for four others that never rest."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(4)]
    yield
    os.sched_setaffinity(0, cores)
    for one in others:
        one.kill()
        one.wait()


def work(*_):
    until = time.thread_time() + WORK_S
    while time.thread_time() < until:
        pass


def complaint(does, budget_s, calls=MANY):
    """What is said of a law after some calls."""
    plain = SimpleNamespace(message_size=0, propagate=does)
    with LawWatch("my_law.py:Mine", 100.0, 1e6, budget_s) as watch:
        law = TimedLaw(plain, watch, "sat1")
        for _ in range(calls):
            law.propagate(None, None, None, None, 0.0, 0.1, 1)
        return watch.complaint()


def test_a_law_is_not_called_slow_because_the_machine_is_busy(crowded):
    assert complaint(work, WORK_S) is None


def test_a_law_that_is_slow_on_a_busy_machine_is_found(crowded):
    assert complaint(work, WORK_S / 4).text.startswith("law my_law.py takes 0.0")


def test_a_law_that_sleeps_is_slow():
    fault = complaint(lambda *_: sleep_until_ns(monotonic_ns() + 20_000_000), 0.005)
    assert fault.id == FaultId.LAW_SLOW
    assert fault.text.startswith("law my_law.py takes 0.0")


def test_a_few_calls_are_not_enough_to_judge_a_law():
    assert complaint(work, WORK_S / 4, MANY - 1) is None


@pytest.mark.parametrize(("where", "calls"), [("host", 3), ("vehicle", 1)])
def test_the_host_divides_the_jet_period_between_the_vehicles(where, calls):
    experiment = load(find("zhang2023_table"), [f'deploy.law="{where}"'])
    experiment = replace(experiment, controller=OwnLawParams("my_law.py:Mine"))
    with watched(experiment) as watch:
        assert watch.budget_s == pytest.approx(experiment.flight.jet_period_s / calls)
