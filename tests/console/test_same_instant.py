"""The live page and the report's scrubber show the same places at the same instant of a run."""

import math

import pytest

import testbed
from testbed.config import load
from testbed.console.picture import LivePicture
from testbed.logs.feed import LogFeed
from testbed.logs.history import gather
from testbed.logs.log_reader import LogReader
from testbed.report.scrubber import flight_data


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flown") / "run"
    testbed.fly(testbed.load("zhang2023_table", "duration_s=10", "criteria={}"), log=folder)
    return folder


def live(run, until):
    """The page's picture when the log has come to that time."""
    picture = LivePicture(load(run / "config.toml"))
    for one in LogFeed(LogReader(run / "log.mcap")).news():
        if one.t > until:
            break
        picture.take([one])
    return picture.now()


@pytest.mark.parametrize("t", [1.0, 4.5, 9.0])
def test_live_and_replayed_are_at_the_same_places(run, t):
    now, data = live(run, t), flight_data(load(run / "config.toml"), gather(
        LogReader(run / "log.mcap")
    ))  # fmt: skip
    assert len(now["vehicles"]) == len(data["vehicles"]) == 3
    for shown, replayed in zip(now["vehicles"], data["vehicles"], strict=True):
        assert shown["name"] == replayed["name"]
        k = now["t"] / data["step"]
        i, share = int(k), k - int(k)
        x, y, turn = (
            (1.0 - share) * replayed[key][i] + share * replayed[key][i + 1]
            for key in ("x", "y", "turn")
        )
        pose = shown["at"]
        assert 1e3 * pose[0] == pytest.approx(x, abs=6.0)  # [mm]: a camera frame of 0.04 m/s
        assert 1e3 * pose[1] == pytest.approx(y, abs=6.0)
        assert math.remainder(pose[2] - math.radians(turn / 1e2), math.tau) == pytest.approx(
            0.0, abs=0.01
        )
