"""The benchmark of record: every law flies, scores are what the runs were, folders count too."""

import math
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from msgspec.structs import replace

from controllers.catalogue import Controller, UsersLaw
from testbed.campaign.benchmark import (
    SHIPPED,
    BenchmarkFile,
    BenchmarkScenario,
    Record,
    load_benchmark,
    scenario_campaign,
    score,
    scores,
)
from testbed.campaign.evidence import read_run, track_of
from testbed.campaign.folders import differences, same_law, score_folders
from testbed.campaign.page import markdown, page, reasons_of
from testbed.campaign.row import FlownRun, columns_of
from testbed.campaign.score import beside_metrics, goal_at, wanted_distances
from testbed.config import SHIPPED as CONFIGS
from testbed.config import ConfigError, dump, find, load
from testbed.core.path import Circle
from testbed.flight.arming import Check
from testbed.metrics.run_metrics import Metrics, Track, VehicleMetrics
from testbed.rig.twin import make_twin
from testbed.run.fly import fly_and_judge
from testbed.run.folder import new_folder, write_config, write_metrics

PATH = CONFIGS / "benchmark.toml"
FILE = load_benchmark(PATH)


@pytest.fixture(params=list(FILE.scenarios))
def campaign(request):
    return scenario_campaign(PATH, FILE, request.param)  # every law fits its scenario, or it raises


def test_every_scenario_is_flown_by_its_laws_as_shipped_and_off(campaign):
    cases = {
        (row["law"], row["vehicle"])
        for row in (campaign.parameters(k) for k in range(campaign.count))
    }
    assert {vehicle for _, vehicle in cases} == {SHIPPED, "off"}
    vehicles = load(find("hold")).vehicles["sat1"].model
    base = campaign.base
    assert f"mass = {vehicles.mass}" in base  # the standard vehicle


def test_every_law_of_the_catalogue_flies():
    flown = set()
    for name in FILE.scenarios:
        one = scenario_campaign(PATH, FILE, name)
        for k in range(one.combinations):
            path = PATH.parent / FILE.scenarios[name].experiment
            texts = [*FILE.scenarios[name].set, *one.overrides(k)]
            flown.add(type(load(path, texts).controller))
    kinds = set(get_args(Controller)) - flown - set(get_args(UsersLaw))
    assert {kind.__name__ for kind in kinds} == set()


def test_a_law_that_is_not_there_is_said(tmp_path):
    path = tmp_path / "b.toml"
    path.write_text(
        'name = "b"\n[laws]\npd = []\n[scenarios.s]\nexperiment = "hold"\nlaws = ["pdd"]\n'
    )
    with pytest.raises(ConfigError, match="did you mean `pd`"):
        load_benchmark(path)


def run(k, outcome="passed", **columns):
    return FlownRun(k, outcome, "", {"contacts": 0, **columns})


def test_a_score_is_the_middle_and_the_worst():
    runs = [run(0, goal_rms_m=0.1, gas_g=5.0), run(1, goal_rms_m=0.3, gas_g=7.0, contacts=2),
            run(2, "failed", goal_rms_m=0.2, gas_g=9.0, clearance_m=-0.1)]  # fmt: skip
    one = score("step", "pd", runs, [run(3), run(4, "fault")])
    assert (one.runs, one.passed, one.contacts) == (3, 2, 2)
    assert (one.error_m, one.worst_error_m, one.gas_g) == (0.2, 0.3, 7.0)
    assert (one.clearance_m, one.settle_s) == (-0.1, None)
    assert (one.robust_passed, one.robust_runs) == (1, 2)


def test_a_run_that_ended_early_is_worse_than_any():
    early = {"gas_g": 1.0, "contacts": 1, "clearance_m": 0.2, "settle_s": 0.5}
    short = [run(k, "fault", **early) for k in range(2)]
    long = [run(k, goal_rms_m=0.1 * k, gas_g=10.0 + k, settle_s=9.0) for k in range(2, 5)]
    one = score("step", "pd", [*short, *long])
    assert (one.error_m, one.gas_g) == (0.4, 14.0)  # the third of five, two are worse than any
    assert (one.worst_error_m, one.contacts, one.clearance_m) == (None, 2, 0.2)
    assert one.settle_s is None
    assert score("step", "pd", long).settle_s == 9.0
    assert score("step", "pd", [*short, *long[:2]]).error_m is None


@pytest.mark.parametrize("first", ["sat1", "sat2"])
def test_what_is_no_number_of_one_vehicle_is_none_of_all(first):
    experiment = load(CONFIGS / "scenarios" / "formation.toml")
    beside = {
        name: {"goal_rms_m": math.nan if name == first else 0.1} for name in experiment.vehicles
    }
    one = VehicleMetrics(*[None] * 10)
    metrics = Metrics("try", "twin", 0, True, 1.0, 1.0, None, 0, None, None, {},
                      dict.fromkeys(experiment.vehicles, one))  # fmt: skip
    columns = columns_of(metrics, experiment, beside)
    assert columns["goal_rms_m"] is None
    assert columns[f"{first}.goal_rms_m"] is None
    assert columns["sat3.goal_rms_m"] == 0.1


def test_a_score_says_why_runs_did_not_pass_the_most_frequent_reason_first():
    missed = [FlownRun(k, "failed", "hold_rms_m") for k in range(2)]
    late = FlownRun(2, "failed", "settle_s is 91.5, more than 90")
    later = FlownRun(3, "failed", "settle_s is 120.1, more than 90")
    passed = FlownRun(4, "passed")
    one = score("step", "pd", [late, later, *missed, *missed[:1], passed], [passed, late])
    settles = "failed: settle_s is ... more than ..."
    assert list(one.reasons.items()) == [("failed: hold_rms_m", 3), (settles, 2)]
    other = score("step", "lqr", [passed])
    assert list(reasons_of([other, one])) == [
        ("step, pd", f"failed: hold_rms_m (3); {settles} (2)"),
        ("step, pd (robust)", f"{settles} (1)"),
    ]


def test_a_law_that_raises_has_a_row_without_numbers():
    table = markdown([score("step", "pd", [FlownRun(0, "error", "boom")])])
    assert "| step | `pd` | 0/1 | - | - | - | - | - | 0 | - | - | - |" in table


def test_scores_tell_laws_and_vehicles_apart():
    campaign = scenario_campaign(PATH, FILE, "hold")
    runs = [run(k, goal_rms_m=float(k)) for k in range(campaign.count)]
    table = scores(campaign, "hold", runs)
    assert [row.law for row in table] == FILE.scenarios["hold"].laws
    assert all((row.runs, row.robust_runs) == (FILE.samples, FILE.samples) for row in table)
    combinations = campaign.combinations
    assert table[0].worst_error_m == float(combinations * (FILE.samples - 1))  # of the first


# Numbers beside the metrics


def track_at(experiment, positions):
    t = np.linspace(0.0, experiment.duration_s, len(positions))
    states = np.zeros((len(t), len(experiment.vehicles), 6))
    states[:, :, :2] = positions
    return Track(t, states)


def test_the_error_is_to_the_goal_where_it_is_by_then():
    experiment = load(CONFIGS / "scenarios" / "circle.toml")
    setup = experiment.vehicles["sat1"]
    t = np.linspace(0.0, experiment.duration_s, 1000)
    goal = goal_at(setup, t)
    assert isinstance(setup.path, Circle)
    assert np.hypot(*goal.T) == pytest.approx(0.8)  # about the table's middle
    off = goal[:, None] + [0.003, 0.004]
    assert beside_metrics(experiment, track_at(experiment, off))["sat1"]["goal_rms_m"] == (
        pytest.approx(0.005)
    )


def test_the_shape_is_the_distances_of_the_formation():
    experiment = load(CONFIGS / "scenarios" / "formation.toml")
    assert wanted_distances(experiment) == {("sat1", "sat2"): 1.5, ("sat2", "sat3"): 1.5}
    chain = np.tile([[-1.5, 0.0], [0.0, 0.0], [1.54, 0.0]], (100, 1, 1))
    found = beside_metrics(experiment, track_at(experiment, chain))
    assert found["sat1"]["shape_rms_m"] == pytest.approx(0.0, abs=1e-12)
    assert found["sat2"]["shape_rms_m"] == pytest.approx(0.04 / 2**0.5)
    assert found["sat3"]["shape_rms_m"] == pytest.approx(0.04)
    assert found["sat1"]["goal_rms_m"] is None


def test_the_clearance_is_to_the_danger_radius():
    experiment = load(CONFIGS / "scenarios" / "crossing.toml")
    places = np.tile([[3.0, 0.0], [3.0, 0.0], [-1.0, 0.6]], (10, 1, 1))  # 0.7 m from o1
    found = beside_metrics(experiment, track_at(experiment, places))
    assert found["sat3"]["clearance_m"] == pytest.approx(-0.1)


# From run folders


class NullObserver:
    """Observer of a flight."""

    def vehicle(self, name, tick): ...

    def host(self, name, tick): ...

    def done(self, t): ...


def test_a_run_folder_scores_like_the_flight(tmp_path):
    experiment = load(find("hold"), ["duration_s=8", "vehicles.sat1.start=[0.0, -0.02, 0.0]"])
    folder = new_folder(tmp_path / "run", "hold")
    write_config(folder, dump(experiment), "test")
    metrics = fly_and_judge(experiment, folder)
    write_metrics(folder, metrics)
    rig = make_twin(experiment)
    rig.fly(NullObserver())
    truth = columns_of(metrics, experiment, beside_metrics(experiment, rig.track()))
    read = read_run(folder, 0, {}, {})
    assert read.columns["goal_rms_m"] == pytest.approx(truth["goal_rms_m"], abs=0.0005)
    assert read.columns["gas_g"] == truth["gas_g"]
    track = track_of(folder, experiment)
    assert track.states.shape[1:] == (1, 6)
    assert track.t[-1] == pytest.approx(7.9)


def test_a_flight_that_an_operator_ended_has_not_passed(tmp_path):
    experiment = load(find("hold"), ["duration_s=1", "criteria={}"])
    folder = new_folder(tmp_path / "run", "hold")
    write_config(folder, dump(experiment), "test")
    metrics = fly_and_judge(experiment, folder)
    for completed, outcome in ((True, "passed"), (False, "fault")):
        write_metrics(folder, replace(metrics, completed=completed))
        assert read_run(folder, 0, {}, {}).outcome == outcome


def test_a_log_cut_off_anywhere_is_said(tmp_path):
    experiment = load(find("hold"), ["duration_s=1", "criteria={}"])
    folder = new_folder(tmp_path / "run", "hold")
    write_config(folder, dump(experiment), "test")
    write_metrics(folder, fly_and_judge(experiment, folder))
    data = (folder / "log.mcap").read_bytes()
    for length in range(0, len(data), len(data) // 40):
        (folder / "log.mcap").write_bytes(data[:length])
        with pytest.raises(ConfigError, match="the complete log of a run"):
            read_run(folder, 0, {}, {})


def test_a_folder_that_is_no_run_is_said(tmp_path):
    with pytest.raises(ConfigError, match=r"no config\.toml"):
        read_run(Path(tmp_path), 0, {}, {})


# Which folders are the benchmark's


def small(**changes):
    """A benchmark of two laws and two scenarios of a second, two seeds each."""
    short = ["duration_s=1", "criteria={}"]
    dropouts = [*short, "table.mocap.dropout_rate=0.3"]
    return BenchmarkFile(**{
        "name": "small",
        "laws": {
            "pd": ["controller={type='pd', bandwidth=0.3}"],
            "lqr": ["controller={type='lqr'}"],
        },
        "scenarios": {
            "still": BenchmarkScenario("hold", ["pd", "lqr"], short),
            "dark": BenchmarkScenario("hold", ["pd"], dropouts, hardware="a card before the lens"),
        },
        "samples": 2,
    } | changes)  # fmt: skip


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """A run of a second that all folders below are copies of."""
    folder = tmp_path_factory.mktemp("flight") / "run"
    experiment = load(find("hold"), ["duration_s=1", "criteria={}"])
    metrics = fly_and_judge(experiment, new_folder(folder, "hold"))
    return (folder / "log.mcap").read_bytes(), metrics


@pytest.fixture
def put(flight, tmp_path):
    log, metrics = flight

    def put(place, *texts, rig="table", law="controller={type='pd', bandwidth=0.3}", **changes):
        """A run folder whose config.toml is `hold` with `texts`."""
        experiment = load(find("hold"), ["duration_s=1", "criteria={}", law, *texts])
        folder = new_folder(tmp_path / place, "hold")
        write_config(folder, dump(experiment), "9.8.7")
        (folder / "log.mcap").write_bytes(log)
        own = replace(metrics, experiment=experiment.name, rig=rig, seed=experiment.seed)
        write_metrics(folder, replace(own, **changes))

    return put


def scored(folder, file=None, whole=None):
    file = file or small()
    return score_folders(PATH, whole or file, file, folder)


def reasons(record):
    return {one.folder: one.reason for one in record.passed_over}


def test_a_run_of_another_law_scenario_or_seed_is_not_scored_whatever_its_folder_is_called(
    put, tmp_path
):
    put("still/pd/0")
    put("still/pd/other law", law="controller={type='lqr'}")
    put("still/pd/other gain", "seed=1", law="controller={type='pd', bandwidth=0.31}")
    put("still/pd/other start", "vehicles.sat1.start=[0.3, 0.0, 0.0]", "seed=1")
    put("still/pd/other filter", "flight.barrier.on=false", "seed=1")
    put("still/pd/other seed", "seed=2")
    put("still/pd/twice")
    record = scored(tmp_path)
    assert [(row.law, row.runs, row.rig) for row in record.scores] == [("pd", 1, "table")]
    said = reasons(record)
    assert "controller.type" in said.pop("still/pd/other law")
    assert said == {
        "still/pd/other gain": "controller.bandwidth is 0.31, the benchmark has 0.3",
        "still/pd/other start": (
            "vehicles.sat1.start is [0.3, 0.0, 0.0], the benchmark has [0.0, -0.1, 0.0]"
        ),
        "still/pd/other filter": "flight.barrier.on is false, the benchmark has true",
        "still/pd/other seed": "seed 2 is not in the benchmark",
        "still/pd/twice": "seed 0 is scored from another folder",
    }
    assert record.not_flown == ["still: pd, seed 1", "still: lqr", "dark: all"]


def test_folders_that_the_benchmark_does_not_have_are_named(put, tmp_path):
    put("still/pd/0")
    put("still/pdd/0")
    put("stil/pd/0")
    (tmp_path / "still" / "pd" / "empty").mkdir()
    said = reasons(scored(tmp_path))
    assert said["still/pdd"] == "not a law of this scenario (did you mean `pd`?)"
    assert said["stil"] == "not a scenario of the benchmark (did you mean `still`?)"
    assert "no config.toml" in said["still/pd/empty"]


def test_a_scenario_that_was_not_asked_for_is_not_passed_over(put, tmp_path):
    put("still/pd/0")
    put("dark/pd/0")
    whole = small()
    part = replace(whole, scenarios={"still": whole.scenarios["still"]})
    assert scored(tmp_path, part, whole).passed_over == []


def test_a_lab_has_its_own_table_and_vehicles_and_what_else_is_its_own_is_named(put, tmp_path):
    put("still/pd/0", "table.tilt.uniform=[0.0, 0.0]", "vehicles.sat1.model.mass=14.0",
        "name=mine", "faults.pose_lost.above=0.4")  # fmt: skip
    record = scored(tmp_path)
    assert record.passed_over == []
    assert record.own == [
        "faults.pose_lost.above = 0.4 (benchmark: 3.0)", "table", "vehicles.*.model",
    ]  # fmt: skip
    assert record.version == "9.8.7"


def test_defaults_that_follow_from_a_labs_own_vehicle_are_no_difference(put, tmp_path):
    put("still/pd/0", "vehicles.sat1.model.mass=25.0", "table.mocap.rate_hz=50.0")
    record = scored(tmp_path)
    assert record.passed_over == []
    assert record.own == ["table", "vehicles.*.model"]


@pytest.mark.parametrize("rig", ["twin", "bench"])
def test_what_a_scenario_sets_has_to_be_there_where_the_rig_plays_it(put, tmp_path, rig):
    put("dark/pd/0", rig=rig)
    put("dark/pd/1", "table.mocap.dropout_rate=0.3", "seed=1", rig=rig)
    record = scored(tmp_path)
    assert reasons(record) == {
        "dark/pd/0": "table.mocap.dropout_rate is 0.02, the benchmark has 0.3"
    }
    assert [(row.runs, row.rig) for row in record.scores] == [(1, rig)]


def test_on_a_table_it_is_the_labs_and_the_page_says_so(put, tmp_path):
    put("dark/pd/0")
    record = scored(tmp_path)
    assert record.passed_over == []
    text = page(record, PATH, small(), " --from FOLDER")
    assert "The lab makes the disturbances of `dark` itself" in text
    assert "1 run on the table" in text
    assert text.index("| rig |") < text.index("| table |")
    assert "* still: all" in text  # not flown


@pytest.mark.parametrize(("key", "said"), [("mocap.dropout_rate=0.3", 0), ("link.loss=0.3", 1)])
def test_the_bench_plays_the_cameras_but_not_the_network(put, tmp_path, key, said):
    file = small(scenarios={"dark": BenchmarkScenario(
        "hold", ["pd"], ["duration_s=1", "criteria={}", f"table.{key}"], hardware="somehow",
    )})  # fmt: skip
    put("dark/pd/0", f"table.{key}", rig="bench")
    text = page(scored(tmp_path, file), PATH, file, "")
    assert text.count("The lab makes the disturbances of") == said


def test_rigs_of_one_cell_are_all_named(put, tmp_path):
    put("still/pd/0")
    put("still/pd/1", "seed=1", rig="bench")
    assert scored(tmp_path).scores[0].rig == "bench + table"


def test_a_run_that_never_armed_is_no_run_and_one_that_a_fault_ended_is(put, tmp_path):
    put("still/pd/0", completed=False, red=[Check("supply", "sat1", "at 80 % of its set value")])
    put("still/pd/1", "seed=1", completed=False, fault="pose lost")
    record = scored(tmp_path)
    assert reasons(record) == {"still/pd/0": "never armed: sat1 supply: at 80 % of its set value"}
    assert [(row.passed, row.runs) for row in record.scores] == [(0, 1)]


def test_folders_of_which_none_is_the_benchmarks_are_refused_with_the_reason(put, tmp_path):
    put("still/pd/0", law="controller={type='lqr'}")
    with pytest.raises(ConfigError, match=r"controller\.type"):
        scored(tmp_path)


def test_an_own_law_is_told_by_its_content_not_by_where_its_file_is():
    here = {"controller": {"type": "python", "law": "mine/law.py:Mine", "sha256": "1"}}
    for law, digest, same in [
        ("law.py:Mine", "1", True), ("law.py:Other", "1", False), ("law.py:Mine", "2", False),
    ]:  # fmt: skip
        there = {"controller": {"type": "python", "law": law, "sha256": digest}}
        left = [one for one in differences(here, there) if not same_law(*one)]
        assert (left == []) == same


# The page


def test_the_page_has_the_limits_of_the_files_and_says_how_sure_it_is():
    runs = [run(k, goal_rms_m=0.001) for k in range(4)]
    table = [score(name, "pd", runs, runs) for name in FILE.scenarios]
    text = page(Record("standard", "1.2.3", table, "c0de"), PATH, FILE, "")
    flat = " ".join(text.split())
    for name in FILE.scenarios:
        assert f"* **{name}**: " in text
    step = load(CONFIGS / "scenarios" / "step.toml")
    assert f"{step.description}; 1 vehicle, 120 s. Passed: `max_contacts` 0" in flat
    assert f"`hold_rms_m` at most {step.criteria.hold_rms_m}" in flat
    assert "`goal_rms_m` at most 0.02" in flat
    assert "`clear_of_obstacles`" in flat.split("**crossing**: ")[1].split("**formation**: ")[0]
    assert "`table.mocap.latency_s=0.05`" in flat
    assert "anywhere from 51 to 100 %" in flat  # Wilson's interval of 4 of 4
    assert "airbearing-testbed 1.2.3 (code c0de)" in flat
    assert "`configs/benchmark.toml`" in flat
    assert "4 seeds per cell" in flat
    assert "`criteria." not in flat  # they are said as limits
    assert "## Not flown" not in text


def test_point_to_point_laws_fly_all_point_to_point_scenarios():
    laws = {"pd", "lqr", "mpc", "smc", "sotsmc", "pd_wrench", "sotsmc_wrench"}
    for name, scenario in FILE.scenarios.items():
        assert set(scenario.laws) in (laws, set(scenario.laws) - laws), name
