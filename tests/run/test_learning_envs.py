"""Environments for learning: the checkers of Gymnasium and PettingZoo, and what an episode is."""

import copy
import math
import os
import pickle
import runpy
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import testbed

if os.environ.get("CI") == "true":  # there a missing tool is a failure
    import gymnasium
    import pettingzoo
else:
    gymnasium = pytest.importorskip("gymnasium", reason="the extra `learn` is not installed")
    pettingzoo = pytest.importorskip("pettingzoo", reason="the extra `learn` is not installed")

from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test

from testbed.env import FleetEnv, TableEnv, table_envs
from testbed.env.action import largest

ROOT = Path(__file__).parents[2]
STEP = ROOT / "configs/scenarios/step.toml"
KINDS = ("force", "wrench", "valves")


def step(*overrides):
    return testbed.load(STEP, "duration_s=60", *overrides)


def flown(env, action, ticks, seed=0):
    """Observations and rewards of an episode of one action."""
    seen, _ = env.reset(seed=seed)
    found, rewards = [seen], []
    for _ in range(ticks):
        seen, reward, ended, late, told = env.step(np.array(action, np.float32))
        found.append(seen)
        rewards.append(reward)
        if ended or late:
            break
    return found, rewards, told


@pytest.mark.parametrize("action", KINDS)
@pytest.mark.parametrize("layout", ["goal", "pose", "rans"])
def test_gymnasium_finds_no_fault(action, layout):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # its advice for bounds, and for an environment that is not registered
        warnings.filterwarnings("ignore", message=".*(infinity|-inf|spec|render_modes).*")
        check_env(TableEnv(step(), action, layout), skip_render_check=True)


@pytest.mark.parametrize("action", KINDS)
def test_pettingzoo_finds_no_fault(action):
    fleet = testbed.load("zhang2023_table", "duration_s=3")
    parallel_api_test(FleetEnv(fleet, action, anywhere=True), num_cycles=60)


def test_a_seed_gives_the_same_episode_and_another_seed_another():
    env = TableEnv(step(), "valves", "pose")
    one, again, other = (flown(env, [0.3] * 8, 20, seed)[0] for seed in (5, 5, 6))
    assert np.array_equal(one, again)
    assert not np.array_equal(one, other)


@pytest.mark.parametrize("action", KINDS)
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_is_at_the_same_point_of_the_episode_and_flies_on_alone(action, copied):
    env = TableEnv(step(), action, "pose", anywhere=True)
    rng = np.random.default_rng(3)
    size = env.action_space.shape
    env.reset(seed=2)
    for _ in range(4):
        env.step(rng.uniform(0.0, 1.0, size))
    other, actions = copied(env), rng.uniform(0.0, 1.0, (6, *size))
    one, another = ([each.step(one) for one in actions] for each in (env, other))
    for (seen, reward, *_, told), (seen_too, reward_too, *_, told_too) in zip(
        one, another, strict=True
    ):
        assert seen.tolist() == seen_too.tolist()
        assert (reward, told) == (reward_too, told_too)
    one, another = env.reset(), other.reset()  # the next episodes are the same, too
    assert one[0].tolist() == another[0].tolist()


def test_a_fleet_and_what_had_no_reset_can_be_copied_too():
    fleet = FleetEnv(testbed.load("zhang2023_table", "duration_s=3"))
    new = copy.deepcopy(fleet)
    fleet.reset(seed=1)
    still = {name: np.zeros(2) for name in fleet.agents}
    fleet.step(still)
    mine, copied = (one.step(still)[0] for one in (fleet, copy.deepcopy(fleet)))
    assert {k: v.tolist() for k, v in mine.items()} == {k: v.tolist() for k, v in copied.items()}
    assert new.reset(seed=1)[0].keys() == set(fleet.possible_agents)


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickle.dumps])
def test_a_twin_is_not_copied_and_says_what_to_do(copied):
    with pytest.raises(testbed.TestbedError, match=r"make another testbed\.Twin of the same"):
        copied(testbed.Twin(step()))


def test_without_a_seed_episodes_go_on_from_the_first():
    def starts():
        env = TableEnv(step(), anywhere=True)
        return [env.reset(seed=3)[0], env.reset()[0], env.reset()[0]]

    first = starts()
    assert np.array_equal(first, starts())
    assert not np.array_equal(first[1], first[2])


def test_tolerances_make_other_vehicles():
    def place(randomise, seed):
        found = flown(TableEnv(step(), randomise=randomise), [1.0, 0.0], 60, seed)
        return np.array(found[2]["true_state"])

    assert np.abs(place(True, 1) - place(True, 2)).max() > 1e-3
    exact = np.abs(place(False, 1) - place(False, 2))[:2].max()
    assert exact < 0.3 * np.abs(place(True, 1) - place(True, 2))[:2].max() + 1e-3


def test_a_force_is_a_share_of_what_the_jets_can_do():
    experiment = step("table.tilt.uniform=[0.0, 0.0]")
    model = experiment.vehicles["sat1"].model
    most, _ = largest(model, 0.6)
    _, _, told = flown(TableEnv(experiment, randomise=False), [0.6, 0.8], 20)
    *_, vx, vy, _ = told["true_state"]
    expected = most / model.mass * 2.0
    assert math.hypot(vx, vy) == pytest.approx(expected, rel=0.1)
    assert math.atan2(vy, vx) == pytest.approx(math.atan2(0.8, 0.6), abs=0.1)


def test_a_wrench_turns_and_pushes_in_the_body_frame():
    experiment = step("table.tilt.uniform=[0.0, 0.0]", "vehicles.sat1.start=[0.0, 0.0, 1.5707963]")
    model = experiment.vehicles["sat1"].model
    env = TableEnv(experiment, "wrench", "pose", randomise=False)
    _, _, pushed = flown(env, [0.5, 0.0, 0.0], 20)
    assert pushed["true_state"][4] > 5.0 * abs(pushed["true_state"][3])  # x of the body is y here
    assert abs(pushed["true_state"][5]) < 0.02
    _, _, turned = flown(env, [0.0, 0.0, 0.2], 20)
    _, torque = largest(model, 0.6)
    assert turned["true_state"][5] == pytest.approx(0.2 * torque / model.inertia * 2.0, rel=0.2)


def test_valves_open_as_asked():
    env = TableEnv(step("table.tilt.uniform=[0.0, 0.0]"), "valves", randomise=False)
    _, _, told = flown(env, [0.5, 0.5, 0, 0, 0, 0, 0, 0], 20)  # jets 1 and 2 push to -x
    model = step().vehicles["sat1"].model
    wanted = -2.0 * 0.5 * model.jets[0].thrust / model.mass * 2.0
    assert told["true_state"][3] == pytest.approx(wanted, rel=0.1)
    assert told["fault"] == ""  # the jet watch was told of the pulses
    _, _, still = flown(env, [0.05] * 8, 20)  # shorter than a valve can open
    assert abs(still["true_state"][3]) < 2e-3


@pytest.mark.parametrize(
    ("reason", "overrides"),
    [
        ("fault", []),  # of the fault table: no room for a full stop
        ("fence", ["faults={}", "flight.gate.fence_margin=0.1"]),
        ("contact", ["faults={}", "obstacles.o={position=[2.8, 0.5], radius=0.31, solid=0.3}"]),
    ],
)
def test_what_ends_an_episode(reason, overrides):
    places = ("vehicles.sat1.start=[2.3, 0.5, 0.0]", "vehicles.sat1.goal=[0.0, 1.0, 0.0]")
    env = TableEnv(step(*places, *overrides), "valves")
    _, rewards, told = flown(env, [0, 0, 0, 0, 1, 1, 0, 0], 100)
    assert (told["ended"], len(rewards) < 100) == (reason, True)
    assert rewards[-1] == -10.0
    assert all(-1.0 < one < 0.0 for one in rewards[:-1])


def test_time_truncates():
    env = TableEnv(testbed.load(STEP, "duration_s=1"))
    env.reset(seed=0)
    ends = [env.step(np.zeros(2, np.float32))[2:4] for _ in range(10)]
    assert ends == [(False, False)] * 9 + [(False, True)]


def test_one_vehicle_ends_the_episode_of_all():
    fleet = FleetEnv(testbed.load("zhang2023_table", "duration_s=30"), "valves")
    fleet.reset(seed=1)
    full = np.array([0, 0, 0, 0, 1, 1, 0, 0], np.float32)
    none = np.zeros(8, np.float32)
    while fleet.agents:
        _, rewards, ended, _, told = fleet.step({"sat1": full, "sat2": none, "sat3": none})
    assert {name: one["ended"] for name, one in told.items()} == {
        "sat1": "fault", "sat2": "", "sat3": "",
    }  # fmt: skip
    assert all(ended.values())
    assert rewards["sat1"] == -10.0


def test_the_rans_layout():
    seen, _ = TableEnv(step(), "valves", "rans", randomise=False).reset(seed=0)
    np.testing.assert_allclose(seen["state"][:2], [1.0, 0.0], atol=0.05)
    np.testing.assert_allclose(seen["state"][5:], [1.0, 1.0, 0.0, 0.0, 1.0], atol=0.05)
    np.testing.assert_allclose(seen["transforms"][0], [-1.0, 0.0, 0.15, 0.09, 0.6], rtol=1e-6)
    assert seen["masks"].tolist() == [0.0] * 8


def test_several_vehicles_need_the_other_environment():
    with pytest.raises(testbed.TestbedError, match="FleetEnv"):
        TableEnv(testbed.load("zhang2023_table"))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"action": "thrust"}, "one of force, wrench, valves"),
        ({"observation": "goals"}, r"one of goal, pose, rans\n.*did you mean `goal`"),
    ],
)
def test_a_misspelt_choice_is_refused(arguments, said):
    with pytest.raises(testbed.TestbedError, match=said):
        TableEnv(step(), **arguments)


def test_an_experiment_is_loaded_first():
    for kind in (TableEnv, FleetEnv):
        with pytest.raises(testbed.TestbedError, match=r"testbed.load\('.*step.toml'\)"):
            kind("step")


def test_a_step_needs_a_reset():
    with pytest.raises(testbed.TestbedError, match="`reset`"):
        TableEnv(step()).step(np.zeros(2))
    fleet = FleetEnv(testbed.load("zhang2023_table"))
    with pytest.raises(testbed.TestbedError, match="`reset`"):
        fleet.step({})


@pytest.mark.parametrize(("action", "size"), [("force", 2), ("wrench", 3), ("valves", 8)])
def test_an_action_of_another_shape_is_refused(action, size):
    env = TableEnv(step(), action)
    env.reset(seed=0)
    for wrong in (None, 0.3, "full", np.zeros(size - 1), np.zeros(size + 1), np.zeros((1, size))):
        with pytest.raises(testbed.TestbedError, match=rf"shape \({size},\)"):
            env.step(wrong)
    env.step([0] * size)


@pytest.mark.parametrize("action", [["1", "0"], np.array([0.0, 1j]), [None, 0.0]])
def test_an_action_that_is_no_real_numbers_is_refused(action):
    env = TableEnv(step())
    env.reset(seed=0)
    with pytest.raises(testbed.TestbedError, match="numbers of shape"):
        env.step(action)


@pytest.mark.parametrize(
    "override",
    [
        'inject=[{kind="stick_open", vehicle="sat1", at_s=1.0, jet=2}]',
        "forks=[{at_s=1.0, seed=3}]",
        "board=inproc",
    ],
)
def test_what_an_environment_does_not_fly_is_refused(override):
    key = override.partition("=")[0]
    experiment = testbed.load("hold", override)
    for kind in (TableEnv, FleetEnv, testbed.Twin):
        with pytest.raises(testbed.TestbedError, match=f"{key} of the experiment") as error:
            kind(experiment)
    plain = experiment.with_({key: "model" if key == "board" else []})
    assert error.value.hint == f"experiment.with_({key}={getattr(plain, key)!r})"
    TableEnv(plain)


def test_each_vehicle_needs_an_action():
    fleet = FleetEnv(testbed.load("zhang2023_table"))
    fleet.reset(seed=0)
    for names in (["sat1", "sat2"], ["sat1", "sat2", "sat3", "sat4"]):
        with pytest.raises(testbed.TestbedError, match="each of sat1, sat2, sat3"):
            fleet.step({name: np.zeros(2) for name in names})


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(("action", "size"), [("force", 2), ("wrench", 3), ("valves", 8)])
def test_an_action_that_is_not_finite_is_a_fault(action, size, number):
    env = TableEnv(step(), action)
    _, rewards, told = flown(env, [0.0] * (size - 1) + [number], 5)
    assert (told["ended"], rewards) == ("fault", [-10.0])
    assert told["fault"].startswith("not_a_number")
    again, _ = env.reset(seed=1)
    assert all(np.isfinite(again))
    assert env.step(np.zeros(size))[2] is False


@pytest.mark.parametrize(("action", "full"), [("wrench", [0, 0, 1]), ("force", [1, 0])])
def test_an_action_beyond_its_bounds_is_the_bound(action, full):
    env = TableEnv(step(), action, "pose")
    one, more = (flown(env, np.multiply(size, full), 3)[0] for size in (1.0, 50.0))
    assert np.array_equal(one, more)


def test_an_observation_is_of_one_time():
    experiment = testbed.load(ROOT / "configs/scenarios/circle.toml")
    setup, period = experiment.vehicles["sat1"], experiment.flight.jet_period_s
    env = TableEnv(experiment, randomise=False)
    _, before = env.reset(seed=0)
    for _ in range(30):
        seen, *_, told = env.step(np.zeros(2))
        goal = np.array(setup.goal[:2]) + setup.path.at(told["t"] - period).p
        np.testing.assert_allclose(seen[:2], goal - before["true_state"][:2], atol=1e-3)
        before = told


def test_a_moving_obstacle_is_seen_at_the_same_time():
    experiment = testbed.load(
        STEP, "obstacles.o={position=[-1.0, 1.5], velocity=[0.1, 0.0], radius=0.2}"
    )
    env = TableEnv(experiment, "force", "pose", randomise=False)
    _, before = env.reset(seed=0)
    for _ in range(5):
        seen, *_, told = env.step(np.zeros(2))
        place = np.array([-1.0 + 0.1 * (told["t"] - 0.1), 1.5])
        np.testing.assert_allclose(seen[11:13], place - before["true_state"][:2], atol=1e-3)
        before = told


def test_the_import_needs_no_library():
    code = (
        "import sys; sys.modules['gymnasium'] = None\n"
        "import testbed, testbed.env\n"
        "assert not {'gymnasium', 'pettingzoo', 'onnxruntime', 'numpy'} & set(sys.modules) - "
        "{'gymnasium'}\n"
        "try: testbed.env.TableEnv\n"
        "except testbed.TestbedError as error: print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert "[learn]" in done.stdout, done.stderr


@pytest.mark.parametrize("processes", [False, True])
def test_an_environment_flies_alone_as_in_a_vector(processes):
    action = np.array([[0.5, -0.2], [-1.0, 0.3], [0.0, 0.0]], np.float32)
    envs = table_envs(step(), 3, processes=processes, anywhere=True)
    try:
        first, _ = envs.reset(seed=7)
        together = [np.array(first)]
        for _ in range(5):
            seen, *_ = envs.step(action)
            together.append(np.array(seen))
    finally:
        envs.close()
    assert np.array(together).shape == (6, 3, 8)
    for k, own in enumerate(action):
        alone, _, _ = flown(TableEnv(step(), anywhere=True), own, 5, seed=7 + k)
        np.testing.assert_array_equal(alone, np.array(together)[:, k])


@pytest.mark.parametrize("number", [0, -1, 1.5, "a", None])
def test_a_vector_has_an_environment(number):
    with pytest.raises(testbed.TestbedError, match="one environment"):
        table_envs(step(), number)


def test_a_scenario_by_its_name_is_refused_with_a_hint_that_loads_it():
    with pytest.raises(testbed.TestbedError) as caught:
        TableEnv("step")
    assert eval(caught.value.hint).name == "step"


def test_a_step_after_the_end_asks_for_a_reset():
    env = TableEnv(step(), "force")
    env.reset(seed=0)
    assert env.step(np.array([math.nan, 0.0]))[2]
    for one in (env, pickle.loads(pickle.dumps(env))):
        with pytest.raises(testbed.TestbedError, match=r"a `reset`, because the episode has ended"):
            one.step(np.zeros(2))
        one.reset()
        assert not one.step(np.zeros(2))[2]
    fleet = FleetEnv(testbed.load("zhang2023_table", "duration_s=0.1"), "force")
    fleet.reset(seed=0)
    fleet.step({name: np.zeros(2) for name in fleet.agents})
    with pytest.raises(testbed.TestbedError, match=r"a `reset`, because the episode has ended"):
        fleet.step({})


def test_the_policy_is_trained_from_any_folder(tmp_path, monkeypatch):
    pytest.importorskip("onnx", reason="the extra `onnx` is not installed")
    monkeypatch.chdir(tmp_path)
    train = runpy.run_path(str(ROOT / "examples/learning/train_policy.py"))
    train["lessons"].__globals__["SAMPLES"] = 3
    inputs, shares = train["lessons"](np.random.default_rng(0))
    assert inputs.shape == (3, 8)
    assert shares.shape == (3, 2)
