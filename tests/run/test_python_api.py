"""`import testbed`: what a script or a notebook is promised."""

import math
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import testbed

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def hold():
    return testbed.load("hold", "duration_s=6", "criteria={}", seed=3)


@pytest.fixture(scope="module")
def run(hold):
    return testbed.fly(hold)


@pytest.fixture(scope="module")
def logged(hold, tmp_path_factory):
    return testbed.fly(hold, log=tmp_path_factory.mktemp("logged") / "run")


def test_the_import_is_light():
    code = (
        "import sys, testbed; heavy = {'numba', 'scipy', 'zenoh', 'rerun', 'click', 'numpy'};"
        "print(sorted(heavy & set(sys.modules)), testbed.__all__ == dir(testbed))"
    )
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env)
    assert done.stdout == "[] True\n", done.stderr


def test_a_name_that_is_not_there_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'flyy'"):
        testbed.flyy  # noqa: B018


def test_a_run_has_columns_of_one_length(run):
    sat1 = run["sat1"]
    n = len(sat1.t)
    assert n == 60
    assert sat1.pose.shape == sat1.twist.shape == sat1.reference.shape == (n, 3)
    assert sat1.wrench.shape == sat1.true_pose.shape == (n, 3)
    assert sat1.on_us.shape == (n, 8)
    np.testing.assert_allclose(sat1.t, 0.1 * np.arange(n), atol=1e-9)


def test_truth_is_at_the_tick_and_the_estimate_at_its_own_time(run):
    sat1 = run["sat1"]
    assert sat1.true_pose[0, :2] == pytest.approx([0.0, -0.1], abs=1e-9)
    known = ~np.isnan(sat1.state_t)
    assert (sat1.state_t[known] > sat1.t[known]).all()
    estimate = np.interp(sat1.t[20:-1], sat1.state_t[known], sat1.pose[known, 1])
    assert np.abs(estimate - sat1.true_pose[20:-1, 1]).max() < 2e-3


def test_a_run_is_a_mapping_of_vehicles(run):
    assert list(run) == ["sat1"]
    with pytest.raises(testbed.TestbedError, match="one of sat1") as caught:
        run["sat2"]
    assert isinstance(caught.value, KeyError)
    assert caught.value.found == "'sat2'"
    assert "sat2" not in run
    assert run.get("sat2") is None


def test_a_table_is_a_mapping_of_columns(run):
    table = run.table("sat1")
    with pytest.raises(testbed.TestbedError, match="one of t, ") as caught:
        table["time"]
    assert isinstance(caught.value, KeyError)
    assert (caught.value.found, caught.value.hint) == ("'time'", "")
    assert table.get("time") is None
    for row in 0, slice(3):
        with pytest.raises(testbed.TestbedError, match="index the columns"):
            table[row]


def test_runs_and_tables_are_compared_as_objects(hold, run):
    other = testbed.fly(hold.with_(duration_s=1))
    assert [one for one in (run, other) if one != run] == [other]
    assert len({run, other, run}) == 2
    assert run["sat1"] != other["sat1"]
    assert run.table("sat1") != run.table("sat1")


def test_the_same_seed_is_the_same_flight_and_another_is_not(hold, run):
    again, other = testbed.fly(hold), testbed.fly(hold.with_(seed=4))
    np.testing.assert_array_equal(again["sat1"].true_pose, run["sat1"].true_pose)
    assert not np.array_equal(other["sat1"].true_pose, run["sat1"].true_pose)


def test_a_change_makes_another_experiment(hold):
    faster = hold.with_({"controller.bandwidth": np.float64(0.3)}, seed=9)
    assert (faster.controller.bandwidth, faster.seed) == (0.3, 9)
    assert (hold.controller.bandwidth, hold.seed) == (0.2, 3)
    many = hold.with_({"vehicles.*.model.mass": 15, "criteria": {"settle_s": 4.0}})
    assert (many.vehicles["sat1"].model.mass, many.criteria.settle_s) == (15.0, 4.0)


@pytest.mark.parametrize(
    ("change", "found"),
    [({"controller.bandwith": 0.3}, "bandwidth"), ({"seed": -1}, "-1"), ({"duration_s": "x"}, "x")],
)
def test_a_wrong_change_says_where_and_what(hold, change, found):
    with pytest.raises(testbed.TestbedError) as caught:
        hold.with_(change)
    error = caught.value
    assert error.where
    assert error.expected
    assert found in str(error)


def test_an_unknown_experiment_is_a_testbed_error():
    with pytest.raises(testbed.TestbedError, match="did you mean `hold`"):
        testbed.load("holt")


def test_an_unknown_rig_and_a_run_without_a_log_are_refused(hold, run):
    with pytest.raises(testbed.TestbedError, match="twin"):
        testbed.fly(hold, rig="tabel")
    with pytest.raises(testbed.TestbedError, match="testbed run --rig table"):
        testbed.fly(hold, rig="table")
    with pytest.raises(testbed.TestbedError, match="fly it with log"):
        testbed.replay(run)


def test_a_bench_without_a_compiler_says_so_before_it_starts(hold, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path / "empty"))
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr("firmware_interface.compiler.CACHE", tmp_path / "cache")
    with pytest.raises(testbed.TestbedError, match="no C compiler found"):
        testbed.fly(hold, rig="bench", log=tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


def test_a_log_is_kept_read_and_replayed(hold, run, tmp_path):
    logged = testbed.fly(hold, log=tmp_path / "run")
    assert {p.name for p in (tmp_path / "run").iterdir()} >= {"log.mcap", "metrics.json"}
    read = testbed.open_run(tmp_path / "run")
    for one in (logged, read):
        np.testing.assert_array_equal(one["sat1"].true_pose, run["sat1"].true_pose)
    assert testbed.replay(read).first_difference is None
    assert testbed.replay(read, "flight.tracker.bandwidth=1.0").first_difference is not None
    with pytest.raises(testbed.TestbedError, match="new or empty folder"):
        testbed.fly(hold, log=tmp_path / "run")
    with pytest.raises(testbed.TestbedError):
        testbed.open_run(tmp_path)


def test_tables_carry_units(run):
    table = run.table("sat1")
    assert (table.units["omega"], table.units["jet1_on"]) == ("rad/s", "us")
    assert len({len(column) for column in table.values()}) == 1
    assert table.units.keys() == set(table)
    frame = run.to_pandas()
    assert list(frame.columns[:2]) == ["vehicle", "t"]
    assert frame.attrs["units"]["true_x"] == "m"
    assert table.to_arrow().schema.field("fx").metadata == {b"unit": b"N"}
    assert "[rad/s]" in table._repr_html_()


def test_figures_are_those_of_the_report(run, tmp_path):
    drawn = run.plot("trajectory", "valves")
    assert [p.name for p in drawn.save(tmp_path)] == ["trajectory.svg", "valves.svg"]
    assert drawn._repr_html_().count("<svg") == 2
    with pytest.raises(testbed.TestbedError, match="trajectory"):
        run.plot("trajektory")


def test_a_sweep_is_a_table_and_two_processes_fly_the_same(hold):
    short = hold.with_(duration_s=2)
    over = {"controller.bandwidth": [0.1, 0.3]}
    alone = testbed.sweep(short, over, seeds=range(2))
    beside = testbed.sweep(short, over, seeds=range(2), jobs=2)
    assert alone.rows == 4
    assert alone["controller.bandwidth"].tolist() == [0.1, 0.1, 0.3, 0.3]
    assert alone["seed"].tolist() == [0, 1, 0, 1]
    for name in alone:
        np.testing.assert_array_equal(alone[name], beside[name])
    assert alone.units["impulse_ns"] == "N s"


def test_a_sweep_refuses_a_wrong_key_before_it_flies(hold):
    with pytest.raises(testbed.TestbedError, match="bandwidth"):
        testbed.sweep(hold, {"controller.bandwith": [0.1]})


def test_nothing_is_printed_and_progress_goes_to_stderr(hold, capfd):
    testbed.fly(hold.with_(duration_s=1))
    assert capfd.readouterr() == ("", "")
    testbed.fly(hold.with_(duration_s=1), progress=True)
    out, said = capfd.readouterr()
    assert out == ""
    assert "of 1 s" in said


def test_ctrl_c_ends_a_flight_with_its_files(tmp_path):
    code = (
        "import os, signal, testbed\n"
        "class Out:\n"
        "    def __init__(self): self.n = 0\n"
        "from testbed.run import fly as flying\n"
        "seen = flying.FlightLog.ticks\n"
        "def once(self, span):\n"
        "    seen(self, span)\n"
        "    if span.times[-1] > 2.0:\n"
        "        flying.FlightLog.ticks = seen\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "flying.FlightLog.ticks = once\n"
        "before = signal.getsignal(signal.SIGINT)\n"
        "try: testbed.fly(testbed.load('hold'), log='run')\n"
        "except KeyboardInterrupt as ended: print(ended.run.passed, ended.run['sat1'].t[20])\n"
        "print(signal.getsignal(signal.SIGINT) is before)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": str(ROOT)}, restore_signals=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    assert done.stdout == "False 2.0\nTrue\n", done.stderr
    assert not testbed.open_run(tmp_path / "run").passed


def test_the_twin_is_driven_tick_by_tick(hold):
    twin = testbed.Twin(hold)
    for _ in range(30):
        ticks = twin.step({"sat1": (0.2, 0.0)})
    x, _, _, vx, *_ = twin.true_state("sat1")
    assert twin.t == pytest.approx(3.0)
    push = 0.2 / hold.vehicles["sat1"].model.mass  # the slope takes or gives 2 mm/s^2
    assert vx == pytest.approx(2.9 * push, abs=2.9 * 0.004)
    assert ticks["sat1"].outputs.state.pose.x == pytest.approx(x, abs=0.01)
    with pytest.raises(testbed.TestbedError, match="one of sat1"):
        twin.step({"sat2": (0.0, 0.0)})


def test_two_twins_of_one_seed_fly_the_same(hold):
    one, two = testbed.Twin(hold), testbed.Twin(hold)
    for twin in (one, two):
        for _ in range(10):
            twin.step({"sat1": (0.1, 0.1)})
    assert one.true_state("sat1") == two.true_state("sat1")


@pytest.mark.parametrize(
    ("call", "where", "expected", "found"),
    [
        (lambda e, r: testbed.fly("hold"), "testbed.fly", "from testbed.load", "'hold'"),
        (lambda e, r: testbed.Twin("hold"), "testbed.Twin", "from testbed.load", "'hold'"),
        (lambda e, r: testbed.sweep("hold"), "testbed.sweep", "from testbed.load", "'hold'"),
        (lambda e, r: testbed.fly_many(["hold"]), "testbed.fly_many", "testbed.load", "'hold'"),
        (lambda e, r: testbed.fly_many(e), "testbed.fly_many", "a list of experiments", "Experim"),
        (
            lambda e, r: testbed.load("hold", ["duration_s=5"]),
            "testbed.load", "key=value", "['duration_s=5']",
        ),
        (lambda e, r: testbed.replay(r, 5), "testbed.replay", "key=value", "5"),
        (lambda e, r: r.fork("20", {"seed": 4}), "fork", "a time of the flight", "'20'"),
        (lambda e, r: r.fork(math.nan, {"seed": 4}), "fork", "a time of the flight", "nan"),
        (lambda e, r: r.fork(2.0, ["seed=4"]), "fork", "values by key", "['seed=4']"),
        (lambda e, r: e.with_(["seed=4"]), "with_", "values by key", "['seed=4']"),
        (
            lambda e, r: testbed.sweep(e, over={"controller.bandwidth": 0.3}),
            "over['controller.bandwidth']", "a list of values", "0.3",
        ),
        (lambda e, r: testbed.sweep(e, over=["seed"]), "over", "values by key", "['seed']"),
        (lambda e, r: testbed.sweep(e, seeds=2), "seeds", "a list of seeds", "2"),
        (lambda e, r: testbed.sweep(e, jobs=0), "sweep, jobs", "1 or more", "0"),
        (lambda e, r: testbed.fly_many([e], jobs=0), "fly_many, jobs", "1 or more", "0"),
        (
            lambda e, r: testbed.sweep(e, {"duration_s": [None]}),
            "over['duration_s']", "a number", "None",
        ),
        (lambda e, r: testbed.sweep(e, {"seed": [1, 2]}), "sweep, over", "other than", "'seed'"),
        (lambda e, r: testbed.sweep(e, seeds=["a"]), "sweep, seeds", "whole numbers", "'a'"),
        (lambda e, r: testbed.sweep(e, seeds=[1.5]), "sweep, seeds", "whole numbers", "1.5"),
        (lambda e, r: testbed.sweep(e, seeds=[3, -1]), "sweep, seeds", "whole numbers", "-1"),
        (lambda e, r: testbed.fly_many([e], limit_s="x"), "limit_s", "above 0", "'x'"),
        (lambda e, r: testbed.fly_many([e], limit_s=-1), "limit_s", "above 0", "-1"),
        (lambda e, r: testbed.fly_many([e], limit_s=math.nan), "limit_s", "above 0", "nan"),
        (lambda e, r: e.with_(duration_s=None), "with_, duration_s", "a number", "None"),
        (lambda e, r: e.with_(inject=[{"at_s": None}]), "inject.at_s", "a number", "None"),
        (lambda e, r: testbed.replay("flown"), "replay, run", "testbed.open_run", "'flown'"),
        (lambda e, r: testbed.replay(None), "replay, run", "testbed.open_run", "None"),
        (lambda e, r: testbed.open_run(3), "testbed.open_run", "a finished run", "3"),
        (lambda e, r: testbed.open_run(__file__), "open_run", "a finished run", "test_python_api"),
        (lambda e, r: testbed.fly(e, log=3), "testbed.fly, log", "a new or empty folder", "3"),
        (lambda e, r: r.plot("trajectory").save(3), "save", "the path of a folder", "3"),
    ],
)  # fmt: skip
def test_a_wrong_argument_says_where_and_what(hold, run, call, where, expected, found):
    with pytest.raises(testbed.TestbedError) as caught:
        call(hold, run)
    error = caught.value
    assert where in error.where
    assert expected in error.expected
    assert found in error.found


@pytest.mark.parametrize(
    ("call", "where"),
    [
        (lambda e, r: e.with_({"controller.bandwith": 0.3}), "with_: "),
        (lambda e, r: testbed.load("hold", "controller.bandwith=0.3"), "testbed.load: "),
        (lambda e, r: testbed.load("hold", "seed"), "testbed.load"),
        (lambda e, r: testbed.sweep(e, {"controller.bandwith": [0.3]}), "testbed.sweep, over: "),
        (lambda e, r: testbed.replay(r, "controller.bandwith=0.3"), "testbed.replay: "),
        (lambda e, r: r.fork(1.0, {"controller.bandwith": 0.3}), "fork: "),
        (lambda e, r: testbed.fork(r, 1.0, "controller.bandwith=0.3"), "fork: "),
        (lambda e, r: testbed.fork(r, 1.0, "seed"), "fork"),
    ],
)
def test_a_wrong_key_is_not_one_of_the_command_line(hold, logged, call, where):
    with pytest.raises(testbed.TestbedError) as caught:
        call(hold, logged)
    assert caught.value.where.startswith(where)
    assert "command line" not in str(caught.value)


@pytest.mark.parametrize("key", ["seed", '"seed"', " seed "])
def test_a_sweep_over_seeds_is_refused_with_the_argument_for_them(hold, key):
    with pytest.raises(testbed.TestbedError) as caught:
        testbed.sweep(hold, {key: range(1, 3)})
    assert caught.value.hint == "seeds=[1, 2]"


def test_a_sweep_over_durations_has_the_asked_and_the_flown_ones(hold):
    fault = [{"kind": "stick_open", "vehicle": "sat1", "at_s": 0.5, "jet": 2}]
    table = testbed.sweep(hold.with_(inject=fault), {"duration_s": [4, 6.0]})
    assert table["duration_s"].tolist() == [4.0, 6.0]
    assert (table["flown_s"] < 3.0).all()
    assert table.units["flown_s"] == "s"
    assert table["outcome"].tolist() == ["fault", "fault"]


@pytest.mark.parametrize("wide", ["vehicles.*.model.mass", "vehicles"])
def test_a_swept_value_that_another_key_overwrites_is_refused(hold, wide):
    narrow = {"vehicles.sat1.model.mass": [12.0, 13.0]}
    with pytest.raises(testbed.TestbedError, match="no other key overwrites") as caught:
        testbed.sweep(hold, {**narrow, wide: [14.0]})
    assert caught.value.found == f"{wide!r} after it"


def test_a_log_in_a_place_that_is_not_writable_names_the_argument(hold, logged, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(testbed.TestbedError, match="choose another with log=") as caught:
        testbed.fly(hold, log=tmp_path / "file" / "run")
    assert "--out" not in str(caught.value)
    with pytest.raises(testbed.TestbedError, match="choose another with log=") as caught:
        testbed.fork(logged, 1.0, log=tmp_path / "file" / "run")
    assert "--out" not in str(caught.value)


@pytest.mark.parametrize(
    ("call", "cure"),
    [
        (lambda e, r: testbed.fly(e), "log=, or the variable TMPDIR"),
        (lambda e, r: testbed.fly(e, log="new"), "log="),
        (lambda e, r: testbed.fork(r, 1.0), "log="),
    ],
)
def test_a_full_disk_names_the_argument_for_another(hold, logged, monkeypatch, call, cure):
    full = SimpleNamespace(free=1_000_000)
    monkeypatch.setattr("testbed.run.folder.disk_usage", lambda place: full)
    with pytest.raises(testbed.TestbedError) as caught:
        call(hold, logged)
    assert caught.value.hint == f"free some space, or choose another disk with {cure}"


def test_a_fault_of_wires_on_the_twin_names_the_rig_and_no_flag(hold):
    quiet = hold.with_(inject=[{"kind": "cut_serial", "vehicle": "sat1", "at_s": 1.0}])
    with pytest.raises(testbed.TestbedError, match="or the rig bench") as caught:
        testbed.fly(quiet)
    assert "--" not in str(caught.value)


@pytest.mark.parametrize(
    "force",
    [(1.0,), (), (math.nan, 0.0), (0.0, math.inf), (0.0, 0.0, 0.0, 0.0), 1.0, ("x", 0.0), None],
)
def test_the_twin_refuses_what_is_no_force(hold, force):
    twin = testbed.Twin(hold)
    with pytest.raises(testbed.TestbedError, match="2 or 3 finite numbers") as caught:
        twin.step({"sat1": force})
    assert (caught.value.where, caught.value.found) == ("Twin.step, sat1", repr(force))
    assert twin.t == 0.0


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(testbed.TestbedError, match=r"no such folder: .*nosuch") as caught:
        testbed.open_run(tmp_path / "nosuch")
    assert "config.toml" not in str(caught.value)


@pytest.mark.parametrize(
    ("package", "extra", "call"),
    [
        ("pandas", "notebook", lambda run: run.to_pandas()),
        ("pandas", "notebook", lambda run: run.table("sat1").to_pandas()),
        ("pyarrow", "export", lambda run: run.table("sat1").to_arrow()),
    ],
)
def test_a_package_that_is_missing_is_named_with_its_pip_line(
    run, monkeypatch, package, extra, call
):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(testbed.TestbedError, match=rf"`{package}` is not installed") as caught:
        call(run)
    assert "pip install" in caught.value.expected
    assert f"[{extra}]" in caught.value.expected
