"""The optimiser's loop, with flights that are a formula."""

import math

import numpy as np
import pytest

from testbed.campaign.row import FlownRun
from testbed.campaign.tuning import OptunaOptimiser, best_of, load_tuning, tune
from testbed.config import ConfigError

BANDWIDTH = {"key": "controller.bandwidth", "low": 0.02, "high": 0.6, "log": True}
DAMPING = {"key": "controller.damping", "low": 0.4, "high": 2.0}
BEST = (0.3, 1.2)  # of the formula


@pytest.fixture
def tuning(write):
    def load_one(**keys):
        defaults = {"gain": [BANDWIDTH, DAMPING], "cost": {"goal_rms_m": 1.0}, "trials": 40}
        return load_tuning(write(**{**defaults, **keys}))

    return load_one


def formula(tasks, order=None):
    """Cost by distance from BEST; too quick and it breaks a criterion."""
    runs = []
    for k, overrides in tasks:
        values = dict(text.split("=") for text in overrides)
        bandwidth, damping = (float(values[f"controller.{n}"]) for n in ("bandwidth", "damping"))
        error = math.log(bandwidth / BEST[0]) ** 2 + (damping - BEST[1]) ** 2
        error += 0.01 * (int(values["seed"]) % 3)
        outcome = "passed" if bandwidth < 0.4 else "failed"
        columns = {"goal_rms_m": error, "max_force_n": bandwidth, "settle_s": None}
        runs.append(FlownRun(k, outcome, "settle_s", columns))
    rng = np.random.default_rng(order) if order is not None else None
    return iter(runs if rng is None else [runs[i] for i in rng.permutation(len(runs))])


def flown(tuning, known=(), order=None):
    new = []
    fly = lambda tasks: formula(tasks, order)  # noqa: E731
    trials = tune(tuning, OptunaOptimiser(tuning), known, fly, new.append)
    return trials, new


@pytest.mark.parametrize("sampler", ["tpe", "cmaes"])
def test_detuned_gains_improve(tuning, sampler):
    trials, _ = flown(tuning(sampler=sampler, set=["controller.bandwidth=0.03"]))
    assert trials[0].gains == [0.03, 1.0]  # as the experiment has them
    best = best_of(trials)
    assert best.cost < 0.1 * trials[0].cost
    assert best.gains[0] < 0.4
    for trial in trials:
        assert 0.02 <= trial.gains[0] <= 0.6
        assert 0.4 <= trial.gains[1] <= 2.0


@pytest.mark.parametrize("sampler", ["tpe", "cmaes"])
def test_the_same_file_gives_the_same_trials_in_whatever_order_runs_end(tuning, sampler):
    first, _ = flown(tuning(sampler=sampler))
    assert flown(tuning(sampler=sampler), order=5)[0] == first
    assert flown(tuning(sampler=sampler, seed=1))[0] != first


@pytest.mark.parametrize("kept", [0, 1, 3, 4, 17, 40])
def test_a_tuning_goes_on_where_it_was_stopped(tuning, kept):
    straight, _ = flown(tuning())
    resumed, new = flown(tuning(), known=straight[:kept])
    assert resumed == straight
    assert [trial.number for trial in new] == list(range(kept, 40))


def test_trials_of_a_batch_may_be_journaled_in_any_order(tuning):
    straight, _ = flown(tuning())
    resumed, _ = flown(tuning(), known=[straight[2], straight[0]])
    assert resumed == straight


def test_what_is_not_safe_is_never_the_best(tuning):
    trials, _ = flown(tuning(most={"max_force_n": 0.1}))
    inside = [trial for trial in trials if trial.gains[0] <= 0.1]
    assert best_of(trials) == min(inside, key=lambda trial: trial.cost)
    assert all(trial.broken == 3 for trial in trials if trial.gains[0] > 0.1)
    nothing, _ = flown(tuning(most={"max_force_n": 0.001}, trials=5))
    assert best_of(nothing) is None
    assert nothing[0].reason == "max_force_n is 0.2, more than 0.001"


def test_a_number_that_a_run_did_not_reach_is_not_safe(tuning):
    trials, _ = flown(tuning(cost={"settle_s": 1.0}, trials=2))
    assert trials[0].reason == "settle_s does not apply, or was not reached"


def test_a_column_that_does_not_exist_is_said(tuning):
    with pytest.raises(ConfigError, match="did you mean `goal_rms_m`"):
        flown(tuning(cost={"goal_rms": 1.0}, trials=1))


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"gain": []}, "a list of 1 to 50"),
        ({"cost": {}}, "length >= 1"),
        ({"gain": [{**BANDWIDTH, "low": -1.0, "log": False}]}, "> 0"),
        ({"gain": [{**BANDWIDTH, "low": 0.0}]}, "low > 0 for log"),
        ({"gain": [{**BANDWIDTH, "low": 0.7}]}, "low < high"),
        ({"gain": [{**BANDWIDTH, "key": "controller.type"}]}, "controller.type"),
        ({"gain": [{**BANDWIDTH, "key": "controller.wideband"}]}, "unknown key"),
        ({"cost": {"goal_rms_m": -1.0}}, "> 0"),
    ],
)
def test_what_is_wrong_is_said_before_anything_flies(tuning, keys, words):
    with pytest.raises(ConfigError) as error:
        tuning(**keys)
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"cost": {"goal_rms": 1.0}}, "did you mean `goal_rms_m`"),
        ({"most": {"max_force": 1.0}}, "did you mean `max_force_n`"),
        ({"gain": [BANDWIDTH, BANDWIDTH]}, "each key once"),
        ({"gain": [{**BANDWIDTH, "low": -1.0, "log": False}]}, "the choice controller.bandwidth="),
    ],
)
def test_a_tuning_of_nothing_is_refused_before_it_flies(tuning, keys, words):
    with pytest.raises(ConfigError) as error:
        tuning(**keys)
    assert words in str(error.value)
    assert "campaign.toml" in str(error.value)
