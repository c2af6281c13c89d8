"""A run folder whose log is cut off or empty, or whose files are of different runs."""

import json
import re
import shutil

import pytest
from click.testing import CliRunner

import testbed
from testbed.campaign.evidence import read_run as read_flown
from testbed.cli.main import main
from testbed.config import ConfigError
from testbed.logs.log_reader import LogReader
from testbed.run.film import make_film
from testbed.run.missing_parts import is_whole, lacks
from testbed.run.recorded import MixedUpError, check_files

KINDS = "csv", "mat", "npz", "parquet", "bag", "rrd"


def fly(name, folder, seed=3):
    base = testbed.load(name, "duration_s=3", "criteria={}", seed=seed)
    return testbed.fly(base, log=folder).folder


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """A run in chunks of 0.05 s, as in real time."""
    out = tmp_path_factory.mktemp("flown") / "a"
    words = ["run", "hold", "duration_s=3", "criteria={}", "--seed", "3", "--speed", "50"]
    CliRunner().invoke(main, [*words, "--out", str(out)])
    return out


@pytest.fixture
def copy(flown, tmp_path):
    shutil.copytree(flown, tmp_path / "b")
    return tmp_path / "b"


def cut(folder, part):
    log = folder / "log.mcap"
    content = log.read_bytes()
    log.write_bytes(content[: int(part * len(content))])


def call(*words):
    result = CliRunner().invoke(main, [str(word) for word in words])
    assert result.exit_code != 70, result.output
    return result


def test_a_whole_run_lacks_nothing(flown, recwarn):
    run = testbed.open_run(flown)
    assert (run.damage, list(recwarn)) == ((), [])
    assert testbed.replay(run).whole
    assert call("report", flown).stderr == ""
    assert run.metrics.epoch_ns is not None


def test_a_log_that_is_cut_off_in_a_copy_is_not_whole(copy):
    cut(copy, 0.5)
    with pytest.warns(UserWarning, match=r"log\.mcap is cut off at \d\.\d\d s.*3\.00 s") as said:
        run = testbed.open_run(copy)
    assert (len(said), len(run.damage)) == (1, 1)
    replay = testbed.replay(run)
    assert (replay.whole, replay.first_difference) == (False, None)
    for words in (
        ["report", copy], ["compare", copy, copy], ["export", copy, "--to", "csv"],
        ["log", copy], ["replay", copy],
    ):  # fmt: skip
        result = call(*words)
        assert result.exit_code == 0
        assert "log.mcap is cut off at " in result.stderr
    page = (copy / "report.html").read_text()
    assert " log.mcap is cut off at " in page
    assert str(copy) not in page


def test_a_log_without_metrics_may_still_be_flown(copy):
    cut(copy, 0.5)
    (copy / "metrics.json").unlink()
    assert "its writer was killed, or it is still being flown" in call("log", copy).stderr
    assert "has no end" in call("replay", copy).stderr


def test_a_finished_run_and_one_without_an_end_give_the_same_kind_of_metrics(tmp_path):
    flown = testbed.open_run(fly("xue2021_table_static", tmp_path / "whole"))
    shutil.copytree(flown.folder, tmp_path / "cut")
    (tmp_path / "cut" / "metrics.json").unlink()  # not judged yet
    running = testbed.open_run(tmp_path / "cut")
    for run in (flown, running):
        radii = {setup.model.radius for setup in run.experiment.vehicles.values()}
        gap = run.metrics.min_vehicle_distance_m - 2.0 * radii.pop()
        assert run.metrics.formation.closest_m == pytest.approx(gap)
        assert run.metrics.formation.end.count == 3


def test_a_log_that_ends_before_its_flight_is_not_whole(copy):
    path = copy / "metrics.json"
    path.write_text(path.read_text().replace('"duration_s": 3.0', '"duration_s": 9.0'))
    book = LogReader(copy / "log.mcap")
    list(book.read())
    assert not is_whole(book)
    said = r"ends at 3\.\d\d s, but its flight ended at 9\.00 s \(metrics\.json\)$"
    assert re.search(said, lacks(book)[0])


@pytest.mark.parametrize("size", [0, 1, 8])
def test_an_empty_log_is_an_error(copy, size):
    content = (copy / "log.mcap").read_bytes()
    (copy / "log.mcap").write_bytes(content[:size])
    with pytest.raises(testbed.TestbedError, match="there are no ticks in the log"):
        testbed.open_run(copy)
    for words in (["report", copy], ["compare", copy, copy], ["export", copy, "--to", "csv"]):
        assert call(*words).exit_code == 2


@pytest.mark.parametrize("name", ["log.mcap", "metrics.json"])
def test_a_file_of_another_seed_is_refused(copy, tmp_path, name):
    shutil.copy(fly("hold", tmp_path / "c", seed=4) / name, copy)
    with pytest.raises(MixedUpError, match="began at another time"):
        testbed.open_run(copy)
    verbs = [["report", copy], ["compare", copy, copy], ["replay", copy], ["dash", copy, "--web"]]
    for words in (*verbs, ["ros2", copy], *(["export", copy, "--to", kind] for kind in KINDS)):
        result = call(*words)
        assert (result.exit_code, "began at another time" in result.stderr) == (2, True), words
    with pytest.raises(ConfigError, match="began at another time"):
        read_flown(copy, 0, {}, {})
    with pytest.raises(MixedUpError):
        make_film(copy, copy / "a.gif", None, 300)


def test_a_configuration_of_another_seed_is_refused(copy, tmp_path):
    shutil.copy(fly("hold", tmp_path / "c", seed=4) / "config.toml", copy)
    with pytest.raises(MixedUpError, match=r"metrics\.json: hold, seed \d\n.*hold, seed 4"):
        testbed.open_run(copy)
    for words in (["report", copy], ["dash", copy], ["export", copy, "--to", "rrd"]):
        assert call(*words).exit_code == 2
        assert "expected  the experiment of metrics.json" in call(*words).stderr


def test_a_log_of_other_vehicles_is_refused_without_metrics_too(copy, tmp_path):
    shutil.copy(fly("xue2021_table_static", tmp_path / "c") / "log.mcap", copy)
    (copy / "metrics.json").unlink()
    with pytest.raises(MixedUpError, match=r"expected  vehicles of config\.toml: sat1"):
        check_files(copy / "log.mcap")
    (copy / "config.toml").unlink()
    check_files(copy / "log.mcap")  # a log alone is not judged


@pytest.mark.parametrize("name", ["log.mcap", "metrics.json"])
def test_a_file_of_other_vehicles_is_refused_in_older_runs_too(copy, tmp_path, name):
    shutil.copy(fly("xue2021_table_static", tmp_path / "c") / name, copy)
    path = copy / "metrics.json"
    tree = json.loads(path.read_text())
    del tree["epoch_ns"]
    path.write_text(json.dumps(tree))
    with pytest.raises(MixedUpError, match=f"{name}\n  expected  vehicles of config.toml: sat1"):
        testbed.open_run(copy)
    assert call("report", copy).exit_code == 2


def test_an_older_run_of_the_same_vehicles_is_read(copy):
    path = copy / "metrics.json"
    path.write_text(path.read_text().replace('"epoch_ns"', '"of_old"'))
    assert testbed.open_run(copy).metrics.epoch_ns is None
