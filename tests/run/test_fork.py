"""`run.fork`: a run flown again up to a tick, and on from there with changes."""

import json
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from msgspec.structs import replace

import testbed
from controllers.law_file import digest
from testbed.cli.main import main
from testbed.cli.replay import fork_run
from testbed.config import ConfigError, Fork, loads
from testbed.logs.log_reader import LogReader
from testbed.rig.resumed import make_resumed
from testbed.rig.wired.host import WireRig
from testbed.run import fork as forking
from testbed.run.folder import write_config
from testbed.run.fork import ForkError, forked
from testbed.run.report import make_report

LAW = """
class Spring:
    step_s = 0.1

    def __init__(self):
        self.calls = 0  # a memory that nobody else sees

    def force(self, own, neighbours, world, t):
        self.calls += 1
        return own.mass * (0.04 * (world.goal.p - own.p) - 0.4 * own.v) + 1e-4 * (self.calls % 7)
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="module")
def run(folder):
    return testbed.fly(
        testbed.load("hold", "duration_s=8", "criteria={}", seed=3), log=folder / "a"
    )


def rows(path):
    return [row[::2] for row in LogReader(path / "log.mcap").read() if "/log" not in row.topic]


def rows_of_ticks(run):
    return [row for row in rows(run.folder) if row[0].rpartition("/")[2] in forking.TICKS]


@pytest.mark.parametrize("t", [0.0, 3.14, 7.9])
def test_a_fork_without_changes_is_the_original(run, t, tmp_path):
    fork = run.fork(t, log=tmp_path / "b")
    assert rows_of_ticks(fork) == rows_of_ticks(run)
    assert np.array_equal(fork["sat1"].true_pose, run["sat1"].true_pose)
    assert fork.folder == tmp_path / "b"
    assert (fork.folder / "report.html").exists()


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.int64])
def test_a_time_may_be_a_number_of_numpy(run, kind, tmp_path):
    t = kind(run["sat1"].t[30])
    assert rows_of_ticks(run.fork(t, log=tmp_path / "b")) == rows_of_ticks(run)


@pytest.mark.parametrize("change", [{"controller.bandwidth": 0.4}, {"seed": 9}])
def test_a_fork_of_a_fork_at_the_same_time_keeps_its_changes(run, change, tmp_path):
    fork = run.fork(4.0, change, log=tmp_path / "b")
    again = fork.fork(4.0, log=tmp_path / "c")
    assert rows_of_ticks(again) == rows_of_ticks(fork) != rows_of_ticks(run)
    both = fork.fork(4.0, {"controller.damping": 0.8}, log=tmp_path / "d")
    (_, first), (_, last) = both.experiment.stages()
    assert (last.seed, last.controller.bandwidth) == (first.seed, first.controller.bandwidth)
    assert testbed.replay(both).first_difference is None


def test_a_log_that_is_cut_off_before_the_fork_is_said_before_anything_flies(tmp_path):
    experiment = testbed.load("hold", "duration_s=40", "criteria={}", seed=3)
    run = testbed.fly(experiment, log=tmp_path / "a")
    data = (run.folder / "log.mcap").read_bytes()
    (run.folder / "log.mcap").write_bytes(data[: len(data) * 2 // 3])
    fork = run.fork(20.0, log=tmp_path / "b")
    assert fork.metrics.duration_s == 40.0
    with pytest.raises(ForkError, match=r"one that is whole up to 24\.9 s") as error:
        run.fork(30.0, log=tmp_path / "c")
    assert "cut off at 24.90 s" in error.value.hint
    assert not (tmp_path / "c").exists()


def test_a_log_of_another_name_is_the_one_that_is_replayed_and_forked(run, tmp_path):
    copy = shutil.copytree(run.folder, tmp_path / "a")
    (copy / "log.mcap").rename(copy / "mine.mcap")
    (copy / "log.mcap").write_bytes(b"not a log")
    mine = testbed.open_run(copy / "mine.mcap")
    assert (mine.folder, mine.log) == (copy, copy / "mine.mcap")
    assert testbed.replay(mine).first_difference is None
    assert rows_of_ticks(mine.fork(4.0, log=tmp_path / "b")) == rows_of_ticks(run)
    assert fork_run(copy / "mine.mcap", 4.0, [], tmp_path / "c", as_json=True) == 0


def test_a_law_with_a_memory_of_its_own_goes_on(folder, tmp_path):
    (tmp_path / "spring.py").write_text(LAW)
    law = f'controller={{type="python", law="{tmp_path}/spring.py:Spring"}}'
    for k, more in enumerate(([], ["guidance.mode=wrench", "deploy.law=vehicle"])):
        base = testbed.load("hold", law, "duration_s=3", "criteria={}", *more)
        run = testbed.fly(base, log=tmp_path / f"a{k}")
        assert rows_of_ticks(run.fork(1.55, log=tmp_path / f"b{k}")) == rows_of_ticks(run)


@pytest.mark.parametrize(
    ("change", "later"),
    [
        ({"controller.bandwidth": 0.4}, 0.5),  # references are sent ahead
        ({"controller": {"type": "lqr"}}, 0.5),
        ({"flight.tracker.bandwidth": 1.2}, 0.2),
        ({"seed": 9}, 0.3),
        ({"inject": [{"kind": "stick_open", "vehicle": "sat1", "at_s": 4.0, "jet": 2}]}, 0.3),
        ({"guidance.mode": "wrench"}, 0.5),
    ],
)
def test_a_change_counts_from_its_tick_on(run, change, later, tmp_path):
    fork = run.fork(4.0, change, log=tmp_path / "b")
    changed = (fork["sat1"].on_us != run["sat1"].on_us[: len(fork["sat1"].t)]).any(axis=1)
    first = float(fork["sat1"].t[changed.argmax()])
    assert changed.any()
    assert 4.0 - 1e-9 <= first <= 4.0 + later + 1e-9
    assert testbed.replay(fork).first_difference is None


def test_its_config_flies_it_again_and_its_report_draws_both(run, tmp_path):
    fork = run.fork(4.0, seed=9, log=tmp_path / "b")
    again = testbed.fly(testbed.load(fork.folder / "config.toml"))
    assert np.array_equal(again["sat1"].true_pose, fork["sat1"].true_pose)
    page = (fork.folder / "report.html").read_text()
    assert "From 4 s on: seed 3 \N{RIGHTWARDS ARROW} 9." in page
    assert "Dotted: a, from which this run was forked." in page
    second = fork.fork(6.0, {"controller.bandwidth": 0.4}, log=tmp_path / "c")
    assert [one.at_s for one in second.experiment.forks] == [4.0, 6.0]
    n = round(6.0 / 0.1)
    assert np.array_equal(second["sat1"].on_us[:n], fork["sat1"].on_us[:n])
    shutil.rmtree(fork.folder)
    testbed.open_run(second.folder)  # without its original it is still a run


@pytest.mark.parametrize(
    ("t", "override", "key"),
    [
        (8.0, "seed=1", "from"),
        (-1.0, "seed=1", "from"),
        (float("nan"), "seed=1", "from"),
        (4.0, "table.size=[5.0, 5.0]", "table"),
        (4.0, "vehicles.sat1.model.mass=14.0", "vehicles"),
        (4.0, "flight.jet_period_s=0.05", "forks.1.flight.jet_period_s"),
        (4.0, "flight.gate.pose_timeout_s=0.4", "forks.1.flight.gate"),
        (4.0, 'inject=[{kind="leak", vehicle="sat1", at_s=3.9}]', "inject"),
        (4.0, "controller.bandwidth=-1", "controller.bandwidth"),
    ],
)
def test_what_cannot_change_in_flight_is_refused(run, t, override, key):
    with pytest.raises(ConfigError) as error:
        forked(run.experiment, t, [override])
    assert error.value.key == key


def test_a_flight_that_is_not_that_of_the_log_stops_the_fork(run, folder, tmp_path):
    other = folder / "edited"
    shutil.copytree(run.folder, other)
    edited = testbed.open_run(other)
    text = (other / "config.toml").read_text()
    (other / "config.toml").write_text(text.replace("seed = 3", "seed = 4"))
    with pytest.raises(ForkError, match="twin: inputs"):
        edited.fork(4.0, log=tmp_path / "b")
    assert not (tmp_path / "b").exists()


def test_a_run_in_memory_has_no_log_to_compare_with():
    run = testbed.fly(testbed.load("hold", "duration_s=1", "criteria={}"))
    with pytest.raises(testbed.TestbedError, match="run with a log"):
        run.fork(0.5)


def test_forks_in_a_file_are_checked(run):
    text = (run.folder / "config.toml").read_text()
    with pytest.raises(ConfigError, match=r"forks\.2\.at_s"):
        loads(text, ["forks=[{at_s = 5.0}, {at_s = 4.0}]"])


def test_the_note_of_a_fork_names_its_original(run, tmp_path):
    fork = run.fork(2.0, log=tmp_path / "b")
    note = json.loads((fork.folder / "fork.json").read_text())
    assert (fork.folder / note["run"]).resolve() == Path(run.folder).resolve()
    assert note["t"] == 2.0


@pytest.fixture
def moved(run, tmp_path):
    """A fork at 4 s, and a copy of its original, beside each other."""
    shutil.copytree(run.folder, tmp_path / "a")
    testbed.open_run(tmp_path / "a").fork(4.0, seed=9, log=tmp_path / "b")
    return tmp_path


def drawn(folder):
    lines = []
    make_report(folder, lines.extend)
    page = (folder / "report.html").read_text()
    assert all(line.replace(f"{folder}/", "") in page for line in lines)
    return "Dotted: a, from which" in page, lines


def test_an_original_that_is_gone_or_damaged_is_not_drawn(moved):
    assert drawn(moved / "b") == (True, [])
    (moved / "a" / "log.mcap").write_bytes(b"no log")
    dotted, (line,) = drawn(moved / "b")
    assert (dotted, "../a has a log that cannot be read" in line) == (False, True)
    shutil.rmtree(moved / "a")
    dotted, (line,) = drawn(moved / "b")
    assert (dotted, line) == (False, "the original of this fork is not drawn: ../a has no log")


@pytest.mark.parametrize("when", ["before the fork", "after it"])
def test_an_original_with_a_log_of_another_name_is_drawn(run, tmp_path, when):
    shutil.copytree(run.folder, tmp_path / "a")
    log = tmp_path / "a" / "log.mcap"
    if when == "before the fork":
        log = log.rename(log.with_name("monday.mcap"))
        (tmp_path / "a" / "log.mcap").write_bytes(b"no log")
    testbed.open_run(log).fork(4.0, seed=9, log=tmp_path / "b")
    if when == "after it":
        log.rename(log.with_name("monday.mcap"))
        log.with_name("another.mcap").write_bytes(b"no log")
    assert drawn(tmp_path / "b") == (True, [])


@pytest.mark.parametrize("is_old", [False, True])
@pytest.mark.parametrize(("name", "seed"), [("hold", 4), ("hold", 3), ("xue2021_table_static", 3)])
def test_another_run_in_the_original_s_place_is_not_drawn(moved, name, seed, is_old):
    """An older note tells another run by its ticks; the same flight, flown again, is as good."""
    shutil.rmtree(moved / "a")
    other = testbed.load(name, "duration_s=8", "criteria={}", seed=seed)
    testbed.fly(other, log=moved / "a")
    note = moved / "b" / "fork.json"
    tree = json.loads(note.read_text())
    if is_old:
        note.write_text(json.dumps({"run": tree["run"], "t": tree["t"]}))
    dotted, lines = drawn(moved / "b")
    assert dotted == (is_old and (name, seed) == ("hold", 3))
    assert dotted or "is another run" in lines[0]


def test_a_fork_after_the_flight_s_end_is_refused(run, tmp_path):
    fault = 'inject=[{kind="stick_open", vehicle="sat1", at_s=1.0, jet=2}]'
    short = testbed.fly(
        testbed.load("hold", "duration_s=8", "criteria={}", fault), log=tmp_path / "a"
    )
    end = short.metrics.duration_s
    assert end < 7.0
    with pytest.raises(ForkError, match=f"before the flight's end at {end:g} s"):
        short.fork(end + 0.5, seed=9, log=tmp_path / "b")
    with pytest.raises(ForkError, match=f"before the flight's end at {end:g} s"):
        short.fork(99.0, seed=9, log=tmp_path / "b")  # nor in an experiment of 8 s
    assert not (tmp_path / "b").exists()


def test_the_page_names_a_change_of_the_whole_run(run, tmp_path):
    fork = run.fork(4.0, {"duration_s": 9.0}, log=tmp_path / "b")
    page = (fork.folder / "report.html").read_text()
    assert "From 4 s on: duration_s 8 \N{RIGHTWARDS ARROW} 9." in page


@pytest.fixture(scope="module")
def wired(run, folder):
    """The run, as if it were of the bench: then only its log counts."""
    copy = folder / "wired"
    shutil.copytree(run.folder, copy)
    text = (copy / "metrics.json").read_text()
    (copy / "metrics.json").write_text(text.replace('"rig": "twin"', '"rig": "bench"'))
    return testbed.open_run(copy)


def test_a_run_on_wires_goes_on_on_the_twin_from_its_estimate(wired, tmp_path):
    fork = wired.fork(4.0, log=tmp_path / "b")
    n = 40
    assert np.array_equal(fork["sat1"].on_us[:n], wired["sat1"].on_us[:n])
    assert np.array_equal(fork["sat1"].pose[:n], wired["sat1"].pose[:n], equal_nan=True)
    off = fork["sat1"].true_pose[n - 1 : n + 1] - wired["sat1"].true_pose[n - 1 : n + 1]
    assert 0.0 < np.abs(off[:, :2]).max() < 1e-3
    later = slice(n, len(fork["sat1"].t))
    assert np.abs(fork["sat1"].pose[later] - wired["sat1"].pose[later])[:, :2].max() < 3e-3
    assert (fork.metrics.rig, fork.metrics.contacts, fork.fault) == ("twin", 0, None)
    assert testbed.replay(fork).first_difference is None
    changed = wired.fork(4.0, {"controller": {"type": "lqr"}}, log=tmp_path / "c")
    assert np.array_equal(changed["sat1"].on_us[:n], fork["sat1"].on_us[:n])
    assert not np.array_equal(changed["sat1"].on_us[n:], fork["sat1"].on_us[n:])


def test_a_run_on_wires_that_todays_chain_flies_otherwise_is_not_forked(wired, tmp_path):
    text = (wired.folder / "config.toml").read_text()
    (wired.folder / "config.toml").write_text(text.replace("bandwidth = 0.8", "bandwidth = 0.9"))
    with pytest.raises(ForkError, match="tracker: commanded_wrench"):
        wired.fork(4.0, log=tmp_path / "b")
    (wired.folder / "config.toml").write_text(text)


def test_a_missing_tick_on_wires_is_named(run):
    rows, reader = forking._ticks(run.folder, 4.0)
    ticks = [("sat1", forking.read(reader, "/sat1/tick", one)) for one in rows["/sat1/tick"]]
    del ticks[7]
    with pytest.raises(testbed.TestbedError, match=r"every tick of sat1.*\n.*none at 0\.7 s"):
        make_resumed(ticks, run.experiment)


def test_the_command_forks(run, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    word = str(run.folder)
    assert fork_run(run.folder, 4.0, ["seed=9"], tmp_path / "b", as_json=True) == 0
    assert json.loads(capsys.readouterr().out)["duration_s"] == 8.0
    assert fork_run(run.folder, 4.0, ["table.size=[5, 5]"], tmp_path / "c", as_json=False) == 2
    assert "key       table" in capsys.readouterr().err
    assert not (tmp_path / "c").exists()
    assert fork_run(run.folder, 4.0, ["sed=9"], tmp_path / "c", as_json=False) == 2
    assert "command line: sed=9" in capsys.readouterr().err
    (tmp_path / "file").touch()
    assert fork_run(run.folder, 4.0, ["seed=9"], tmp_path / "file" / "c", as_json=False) == 2
    assert "choose another with --out" in capsys.readouterr().err
    done = CliRunner().invoke(main, ["replay", word, "--out", "d"])
    assert (done.exit_code, "--out belongs to --from" in done.output) == (2, True)
    done = CliRunner().invoke(main, ["replay", word, "--from", "4", "--view", "--out", "d"])
    assert (done.exit_code, "--view plays RUN" in done.output) == (2, True)
    assert not (tmp_path / "d").exists()


def test_only_vehicles_on_the_twin_change_in_flight(run):
    with pytest.raises(ConfigError, match="only the twin flies them"):
        WireRig(replace(run.experiment, forks=[Fork(1.0)]), bench=True)


def test_two_laws_of_one_name_are_both_kept(tmp_path):
    laws = []
    for k in range(2):
        (tmp_path / str(k)).mkdir()
        file = tmp_path / str(k) / "law.py"
        file.write_text(f"K = {k}\n")
        laws.append({"type": "python", "law": f"{file}:Law", "sha256": digest(file)})
    tree = {"controller": laws[0], "forks": [{"at_s": 1.0, "controller": laws[1]}]}
    write_config(tmp_path, tree, "0")
    kept = tomllib.loads((tmp_path / "config.toml").read_text())
    names = [kept["controller"]["law"], kept["forks"][0]["controller"]["law"]]
    assert names == ["law.py:Law", "law_2.py:Law"]
    assert (tmp_path / "law_2.py").read_text() == "K = 1\n"
