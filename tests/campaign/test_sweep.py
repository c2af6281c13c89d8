"""Which runs a campaign file stands for."""

import numpy as np
import pytest
import tomli_w

from testbed.campaign.inline_toml import inline
from testbed.campaign.sweep import Draw, load_campaign
from testbed.config import ConfigError, load
from testbed.config.tree import parse

BANDWIDTH = {"key": "controller.bandwidth", "values": [0.1, 0.2, 0.4]}
DAMPING = {"key": "controller.damping", "values": [0.5, 1.0, 2.0]}
LATE = {"name": "late", "cases": {"no": [], "yes": ["table.mocap.latency_s=0.1"]}}
LAWS = {
    "name": "law",
    "cases": {"slow": ["controller.bandwidth=0.1"], "smc": ["controller={type='smc'}"]},
}
WIDE = {"key": "controller.bandwidth", "low": 0.1, "high": 0.2}
STARTS = {"name": "start", "cases": {"near": [], "far": ["vehicles.sat1.start=[0.5,0.0,0.0]"]}}
MASS = {"key": "vehicles.*.model.mass", "low": 11.0, "high": 14.0}
LATENCY = {"key": "table.mocap.latency_s", "mean": 0.05, "sd": 0.005}


def all_runs(campaign):
    return [campaign.overrides(k) for k in range(campaign.count)]


def test_a_grid_is_every_combination_with_every_sample(write):
    campaign = load_campaign(write(grid=[DAMPING, LATE], samples=2, seed=7))
    runs = {tuple(campaign.parameters(k).values()) for k in range(campaign.count)}
    assert runs == {
        (damping, late, seed)
        for damping in (0.5, 1.0, 2.0) for late in ("no", "yes") for seed in (7, 8)
    }  # fmt: skip


def test_a_sample_is_the_same_wherever_on_the_grid(write):
    campaign = load_campaign(write(grid=[BANDWIDTH], draw=[MASS], samples=4))
    for k in range(0, campaign.count, 3):
        rows = [campaign.parameters(k + i) for i in range(3)]
        assert len({(row["seed"], row["vehicles.*.model.mass"]) for row in rows}) == 1


def test_more_samples_or_another_key_change_no_random_draw(write):
    few = load_campaign(write(draw=[MASS], samples=5))
    more = load_campaign(write(draw=[LATENCY, MASS], samples=50))
    for k in range(5):
        assert few.parameters(k).items() <= more.parameters(k).items()


@pytest.mark.parametrize("design", ["random", "latin_hypercube"])
def test_the_file_alone_decides(write, design):
    path = write(grid=[BANDWIDTH], draw=[MASS, LATENCY], samples=9, design=design)
    assert all_runs(load_campaign(path)) == all_runs(load_campaign(path))


def test_another_seed_draws_anew(write):
    a, b = (load_campaign(write(draw=[MASS], samples=3, seed=s)) for s in (0, 100))
    assert {r[0] for r in all_runs(a)}.isdisjoint(r[0] for r in all_runs(b))


def test_a_latin_hypercube_has_one_draw_in_each_slice(write):
    campaign = load_campaign(write(draw=[MASS, LATENCY], samples=20, design="latin_hypercube"))
    masses = [campaign.parameters(k)["vehicles.*.model.mass"] for k in range(20)]
    slices = np.floor((np.array(masses) - 11.0) / 3.0 * 20).astype(int)
    assert sorted(slices) == list(range(20))


def test_draws_keep_their_ends_and_their_shape(write):
    log = {"key": "controller.bandwidth", "low": 0.01, "high": 1.0, "log": True}
    campaign = load_campaign(write(draw=[log, LATENCY], samples=2000))
    rows = [campaign.parameters(k) for k in range(2000)]
    bandwidth = np.array([row["controller.bandwidth"] for row in rows])
    latency = np.array([row["table.mocap.latency_s"] for row in rows])
    assert bandwidth.min() >= 0.01
    assert bandwidth.max() <= 1.0
    assert np.median(bandwidth) == pytest.approx(0.1, rel=0.15)
    assert latency.mean() == pytest.approx(0.05, abs=5e-4)
    assert latency.std() == pytest.approx(0.005, rel=0.1)


def test_the_ends_of_a_whole_draw_are_as_likely_as_the_others(write):
    grams = {"key": "vehicles.*.model.mass", "low": 10.0, "high": 13.0, "whole": True}
    campaign = load_campaign(write(draw=[grams], samples=400, design="latin_hypercube"))
    drawn = [campaign.parameters(k)["vehicles.*.model.mass"] for k in range(400)]
    assert {mass: drawn.count(mass) for mass in sorted(drawn)} == dict.fromkeys(range(10, 14), 100)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"grid": [DAMPING, LAWS]}, "`controller` of law, which replaces it"),
        ({"grid": [{**BANDWIDTH, "name": "b"}], "draw": [WIDE]}, "of controller.bandwidth, which"),
        ({"draw": [{**MASS, "key": "vehicles.sat1.model.mass"}, MASS]}, "which replaces it"),
    ],
)
def test_a_column_that_says_what_was_not_flown_is_refused(write, keys, words):
    with pytest.raises(ConfigError) as error:
        load_campaign(write(**keys))
    assert words in str(error.value)


def test_one_axis_may_refine_what_another_one_set(write):
    law = {"name": "law", "cases": {"as it is": [], "pd": ["controller={type='pd'}"]}}
    one = {**MASS, "key": "vehicles.sat1.model.mass"}
    assert load_campaign(write(grid=[law, BANDWIDTH], draw=[MASS, one])).combinations == 6


def test_whole_numbers_are_drawn_evenly_to_the_ends():
    draw = Draw(key="seed", low=1.0, high=3.0, whole=True)
    found = [draw.at(share) for share in np.arange(0.5, 300) / 300]
    assert np.bincount(found).tolist() == [0, 100, 100, 100]
    assert (draw.at(0.0), draw.at(1.0)) == (1, 3)
    assert Draw(key="seed", low=1.0, high=9.0, whole=True, log=True).at(0.0) == 1
    with pytest.raises(ValueError, match="whole ends"):
        Draw(key="seed", low=0.5, high=3.0, whole=True)


def test_a_run_is_what_its_command_line_flies(write, tmp_path):
    campaign = load_campaign(write(grid=[LAWS], draw=[MASS], set=["duration_s=5"], seed=3))
    base = tmp_path / "base.toml"
    base.write_text(campaign.base)
    experiment = load(base, campaign.overrides(1))
    assert type(experiment.controller).__name__ == "SmcParams"
    assert experiment.duration_s == 5.0
    assert experiment.seed == 3
    assert experiment.vehicles["sat1"].model.mass == campaign.parameters(1)["vehicles.*.model.mass"]


@pytest.mark.parametrize(
    "value",
    [1, -2.5e-7, 0.1 + 0.2, True, 'quo"ted\\', [1.0, [2, 3]], {"type": "pd", "a b": {"c": []}}],
)
def test_a_value_on_one_line_reads_back(value):
    assert parse(f"value = {inline(value)}".encode())["value"] == value
    assert "\n" not in inline(value)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"grid": [{"key": "controller.bandwith", "values": [1.0]}]}, "did you mean `bandwidth`"),
        ({"grid": [{"key": "controller.bandwidth", "values": [-1.0]}]}, "> 0"),
        ({"grid": [{**BANDWIDTH, **LAWS}]}, "either key and values, or name and cases"),
        ({"draw": [{"key": "duration_s", "low": 2.0, "high": 1.0}]}, "low < high"),
        ({"draw": [{"key": "duration_s", "low": 0.0, "high": 1.0, "log": True}]}, "low > 0"),
        ({"draw": [{"key": "duration_s", "low": 1.0}]}, "low and high, or mean and sd"),
        (
            {"draw": [{"key": "duration_s", "name": "long", "low": -1.0, "high": 9.0}]},
            "found     -1.0",
        ),
        ({"draw": [{"key": "duration_s", "low": 2.5, "high": 9.0, "whole": True}]}, "whole ends"),
        ({"draw": [{"key": "duration_s", "mean": 9.0, "sd": 1.0, "log": True}]}, "low and high"),
        ({"grid": [{"key": "duration_s", "values": []}]}, "found     none for duration_s"),
        ({"grid": [{"key": "seed", "name": "mine", "values": [1, 2]}]}, "seed + j"),
        ({"most": {"gas_g": float("nan")}}, "a finite number"),
        ({"most": {"sat2.gas_g": 1.0}}, "no such vehicle (did you mean `sat1`?)"),
        ({"draw": [{"key": "seed", "low": 1.0, "high": 9.0}]}, "seed + j"),
        ({"grid": [{"name": "seed", "cases": {"a": []}}]}, "none called seed"),
        ({"grid": [BANDWIDTH, BANDWIDTH]}, "each column once"),
        ({"samples": 0}, ">= 1"),
        ({"sampels": 3}, "did you mean `samples`"),
        ({"experiment": "hodl"}, "did you mean `hold`"),
        ({"set": ["duration_s"]}, "key=value"),
        ({"name": "../up"}, "letters, digits"),
        ({"grid": [BANDWIDTH], "samples": 999_999}, "at most 1000000 runs"),
    ],
)
def test_what_is_wrong_is_said_before_anything_flies(write, keys, words):
    with pytest.raises(ConfigError) as error:
        load_campaign(write(**keys))
    assert words in str(error.value)


def test_the_experiment_may_stand_beside_the_campaign(write, tmp_path):
    campaign = load_campaign(write(set=["duration_s=4"]))
    (tmp_path / "mine.toml").write_text(campaign.base)
    assert tomli_w.dumps(parse(load_campaign(write(experiment="mine.toml")).base.encode()))


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"grid": [{"key": "controller.bandwith", "values": [1.0]}]}, "with controller.bandwith="),
        ({"set": ["controller.bandwith=1"]}, "campaign.toml, set"),
        ({"experiment": "hodl"}, "key       experiment"),
        ({"grid": [{"key": "controller.bandwidth", "values": [0.1, 0.1]}]}, "each value once"),
        ({"most": {"goal_rms": 1.0}}, "did you mean `goal_rms_m`"),
        ({"least": {"sat1.contacts": 1.0}}, "key       least.sat1.contacts"),
        ({"most": {"gas_g": float("nan")}}, "key       most.gas_g"),
        ({"draw": [{**LATENCY, "log": True}]}, "expected  low and high for log"),
    ],
)
def test_what_is_wrong_in_the_file_is_looked_for_in_the_file(write, keys, words):
    with pytest.raises(ConfigError) as error:
        load_campaign(write(**keys))
    assert words in str(error.value)
    assert "campaign.toml" in str(error.value)
    assert "command line" not in str(error.value)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"grid": [{**BANDWIDTH, "name": "outcome"}]}, '"outcome", a column'),
        ({"grid": [{"key": "duration_s", "values": [3.0]}]}, '"duration_s", a column'),
        ({"draw": [{**MASS, "name": "met.gas"}]}, '"met.gas", a column'),
        ({"grid": [{"key": "seed", "name": "s", "values": [1, 2]}]}, "the key `seed`"),
        ({"set": ["seed=5"]}, "the key `seed`"),
    ],
)
def test_no_column_says_what_is_not_flown(write, keys, words):
    with pytest.raises(ConfigError) as error:
        load_campaign(write(**keys))
    assert words in str(error.value)
    one_by_one = {"draw": [MASS, {**MASS, "key": "vehicles.sat1.model.mass"}]}
    assert load_campaign(write(**one_by_one)).count == 1


def test_columns_that_a_run_has_can_be_bounded(write):
    bounds = {"goal_rms_m": 1.0, "contacts": 0.0, "sat1.settle_s": 9.0, "clearance_m": 1.0}
    assert load_campaign(write(most=bounds)).file.most == bounds


@pytest.mark.parametrize(
    "keys",
    [
        {"grid": [{"name": "law", "cases": {"far": ["no assignment"]}}]},
        {"draw": [{"key": "a b", "low": 0.0, "high": 1.0}]},
    ],
)
def test_a_setting_that_sets_nothing_is_refused(write, keys):
    with pytest.raises(ConfigError, match="key=value"):
        load_campaign(write(**keys))
