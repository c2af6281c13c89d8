"""The time of a log: UTC at time 0 of the run, which in real time begins after arming."""

import time

import pytest

from testbed.config import find, load
from testbed.logs.log_reader import LogReader
from testbed.run.fly import fly_and_judge

LONG_AGO = 1_000_000_000 * 10**9  # [ns]


@pytest.mark.parametrize("speed", [None, 1e3])
def test_a_flight_in_real_time_begins_with_its_first_tick(speed, tmp_path):
    experiment = load(find("hold"), ["duration_s=1"])
    before = time.time_ns()
    fly_and_judge(experiment, tmp_path, speed=speed, epoch_ns=LONG_AGO)
    log = LogReader(tmp_path / "log.mcap")
    assert any(log.read())
    epoch = log.epoch
    if speed is None:
        assert epoch == LONG_AGO  # virtual time: the caller decides
    else:
        assert before - 1_000_000 <= epoch <= time.time_ns() + 1_000_000  # two clocks
