"""An operator changes a flight on the twin: gains and sticks are replayed to the last bit."""

import tomllib
from functools import partial

import numpy as np
import pytest
from msgspec.structs import replace

from testbed.config import dump, find, load
from testbed.core.types import HostTick, Tick
from testbed.logs.feed import LogFeed, SeenPhase
from testbed.logs.log_reader import LogReader
from testbed.net.operator_requests import ReadControls, Revert, Steer, Tune
from testbed.rig.live import LiveFlight
from testbed.rig.twin import make_twin
from testbed.run.fly import fly_and_judge
from testbed.run.folder import write_config, write_forks
from testbed.run.replay import replay_experiment

LAW = """
import numpy as np


class Mine:
    step_s = 0.02

    def __init__(self, pull: float = 0.1, push: float = 0.0):
        assert push < 1.0, "too much"
        self.pull = pull

    def force(self, own, neighbours, world, t):
        return self.pull * (world.goal.p - own.p) - own.v
"""


class Requests:
    """Requests by the tick at which they arrive; with `sampled`, just before its hosts."""

    def __init__(self, sampled=(), **prepared):
        self.prepared = {int(k[1:]): request for k, request in prepared.items()}
        self.sampled, self.replies, self._calls = dict(sampled), [], -1

    def received(self):
        self._calls += 1
        tick, second = divmod(self._calls, 2)
        request = (self.sampled if second else self.prepared).get(tick)
        if request is not None:
            yield request, self.replies.append


class Flight:
    """One flight with its requests, and its log."""

    def __init__(self, folder, requests, *overrides):
        self.experiment = load(find("hold"), ["criteria={}", *overrides])
        write_config(folder, dump(self.experiment), "1")
        self.live = LiveFlight(self.experiment, requests, partial(write_forks, folder))
        self.live._now_ns = lambda: round(1e9 * self.live._t)
        self.log = folder / "log.mcap"
        self.metrics = fly_and_judge(
            self.experiment, folder, make=lambda one: replace(make_twin(one), live=self.live)
        )
        assert self.metrics.completed
        self.saved = load(folder / "config.toml", [])
        self.news = [(n.t, n.message) for n in LogFeed(LogReader(self.log)).news()]

    def states(self):
        ticks = [(t, one.outputs.state) for t, one in self.news if isinstance(one, Tick)]
        return np.array([
            (t, s.pose.x, s.pose.y, s.twist.vx, s.twist.vy, s.twist.omega) for t, s in ticks if s
        ])  # fmt: skip

    def words(self):
        return [one.because for _, one in self.news if isinstance(one, SeenPhase)]

    def replayed(self, experiment=None):
        return replay_experiment(experiment or self.saved, self.log).first_difference


@pytest.fixture
def fly(tmp_path):
    return partial(Flight, tmp_path)


def test_gains_change_at_a_tick_and_are_replayed(fly):
    requests = Requests(_20=Tune({"bandwidth": 0.5}), _40=Revert(), _50=ReadControls())
    flight = fly(requests, "duration_s=6")
    assert [one.ok for one in requests.replies] == [True] * 3
    assert [(f.at_s, f.controller.bandwidth) for f in flight.saved.forks] == [
        (pytest.approx(2.2), 0.5), (pytest.approx(4.2), 0.2),
    ]  # fmt: skip
    assert "gains from 2.2 s on: bandwidth 0.2 to 0.5" in flight.words()
    assert "gains from 4.2 s on: bandwidth 0.5 to 0.2" in flight.words()
    assert requests.replies[0].controls.gains == {"bandwidth": 0.5, "damping": 1.0}
    assert requests.replies[0].controls.start["bandwidth"] == 0.2
    assert flight.replayed() is None
    first = flight.replayed(flight.experiment)  # as if nothing had been changed
    assert first.t == pytest.approx(2.2)


def test_the_same_changes_fly_again_from_the_saved_experiment(fly, tmp_path):
    flight = fly(Requests(_20=Tune({"bandwidth": 0.5})), "duration_s=4")
    again = tmp_path / "again"
    again.mkdir()
    assert fly_and_judge(flight.saved, again).completed
    rows = [[n.message for n in LogFeed(LogReader(one)).news() if isinstance(n.message, Tick)]
            for one in (flight.log, again / "log.mcap")]  # fmt: skip
    assert rows[0] == rows[1]


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (Tune({"bandwidth": -1.0}), "bandwidth > 0"),
        (Tune({"speed": 1.0}), "one of: bandwidth, damping"),
        (Tune({"bandwidth": 0.5, "damping": 0.0}), "damping > 0"),
        (Steer("sat9", "velocity", "me"), "no vehicle sat9"),
    ],
)
def test_a_wrong_request_changes_nothing_and_says_why(fly, wrong, words):
    requests = Requests(_5=wrong)
    flight = fly(requests, "duration_s=2")
    assert not requests.replies[0].ok
    assert words in requests.replies[0].words
    assert flight.saved == flight.experiment
    assert flight.replayed() is None


def test_the_last_ticks_do_not_change(fly):
    requests = Requests(_18=Tune({"bandwidth": 0.5}))
    flight = fly(requests, "duration_s=2")
    assert requests.replies[0].words == "the flight is nearly over"
    assert flight.saved.forks == []


def test_a_law_on_board_has_live_gains_but_no_stick(fly):
    steer = Steer("sat1", "velocity", "me")
    requests = Requests({25: steer}, _10=Tune({"bandwidth": 0.5}))
    flight = fly(requests, "duration_s=4", 'deploy.law="vehicle"')
    assert [one.ok for one in requests.replies] == [True, False]
    assert 'needs deploy.law = "host"' in requests.replies[1].words
    assert flight.replayed() is None
    assert flight.replayed(flight.experiment) is not None


def test_a_users_law_changes_and_is_the_copy_in_the_folder(fly, tmp_path):
    (tmp_path / "made").mkdir()
    law = tmp_path / "made" / "law.py"
    law.write_text(LAW)
    requests = Requests(_5=Tune({"parameters.pull": 0.3}), _12=Tune({"parameters.push": 2.0}))
    flight = fly(requests, "duration_s=3", f'controller={{type="python",law="{law}:Mine"}}')
    assert [one.ok for one in requests.replies] == [True, False]
    assert "too much" in requests.replies[1].words
    tree = tomllib.loads((tmp_path / "config.toml").read_text())
    assert tree["forks"][0]["controller"]["law"] == tree["controller"]["law"] == "law.py:Mine"
    assert (tmp_path / "config.toml").read_text().startswith("# Resolved by")
    assert flight.replayed() is None


def by_hand(first, last, x, y, turn=0.0, mode="velocity", by="me", **kept):
    """A stick that is held from one tick to another."""
    return kept | {
        k: Steer("sat1", mode, by, round(k * 1e8), x, y, turn) for k in range(first, last)
    }


def test_a_vehicle_is_flown_by_hand_and_replayed(fly):
    requests = Requests(by_hand(20, 60, 0.6, -0.8, 1.0))
    flight = fly(requests, "duration_s=13")
    t, x, y, vx, vy, omega = flight.states().T
    flown, after = (t > 4.0) & (t < 6.0), t > 11.5
    assert vx[flown].mean() > 0.05 > -0.05 > vy[flown].mean()
    assert omega[flown].mean() > 0.1
    # dead man: the last message is of 5.9 s, and it is known for 0.3 s
    sticks = {t: one.inputs.stick for t, one in flight.news if isinstance(one, HostTick)}
    alive = [t for t, one in sticks.items() if one is not None and one.alive]
    assert (min(alive), max(alive)) == (pytest.approx(2.0), pytest.approx(6.2))
    assert np.hypot(vx, vy)[after].max() < 0.02
    assert np.ptp(x[after]) + np.ptp(y[after]) < 0.03
    assert "sat1: flown by hand" in flight.words()
    assert flight.replayed() is None
    assert flight.metrics.fault is None


def test_it_is_given_back_in_flight_without_a_bump(fly):
    sticks = by_hand(20, 50, 1.0, 0.0, 1.0)
    flight = fly(Requests(sticks | {50: Steer("sat1", "law", "me", 50 * 10**8)}), "duration_s=8")
    hosts = [one for _, one in flight.news if isinstance(one, HostTick)]
    before, after = (hosts[k].outputs.setpoint.references[0] for k in (49, 50))
    assert after.twist.vx == pytest.approx(before.twist.vx, abs=0.02)
    assert after.twist.omega == pytest.approx(before.twist.omega, abs=0.05)
    assert abs(after.pose.x - before.pose.x - 0.1 * before.twist.vx) < 0.02
    assert hosts[50].inputs.stick is None
    assert "sat1: the law flies" in flight.words()
    assert flight.replayed() is None


def test_gains_may_change_while_the_law_waits(fly):
    sticks = by_hand(10, 20, 0.5, 0.0) | {30: Steer("sat1", "law", "me", 30 * 10**8)}
    flight = fly(Requests(sticks, _15=Tune({"bandwidth": 0.5})), "duration_s=5")
    assert len(flight.saved.forks) == 1
    assert flight.replayed() is None


def test_another_page_cannot_take_a_vehicle_that_is_flown(fly):
    theirs = by_hand(15, 18, -1.0, 0.0, by="other")
    requests = Requests(by_hand(10, 20, 1.0, 0.0) | theirs | by_hand(25, 28, 0.0, 1.0, by="other"))
    fly(requests, "duration_s=4")
    refused = [one.words for one in requests.replies if not one.ok]
    assert refused == ["another page flies sat1"] * 3
    assert requests.replies[-1].controls.by == {"sat1": "other"}  # mine had gone silent


def test_a_stick_cannot_leave_its_range(fly):
    flight = fly(Requests(by_hand(5, 30, 1e9, -1e9, 1e9)), "duration_s=4")
    sticks = [one.inputs.stick for _, one in flight.news if isinstance(one, HostTick)]
    assert {(one.x, one.y, one.turn) for one in sticks if one and one.alive} == {(1.0, -1.0, 1.0)}
    _, _, _, vx, vy, _ = flight.states().T
    assert np.hypot(vx, vy).max() < 0.2
