"""`testbed log` and `testbed export`."""

import json
from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def run(tmp_path, monkeypatch, testbed) -> Path:
    monkeypatch.chdir(tmp_path)
    testbed("run", "hold", "duration_s=2", "--out", "out")
    return Path("out")


def test_topics_rates_and_gaps(testbed):
    result = testbed("log", "out", "--json")
    assert result.exit_code == 0
    contents = json.loads(result.stdout)
    assert contents["finished"] is True
    topics = {t["topic"]: t for t in contents["topics"]}
    assert list(topics) == [
        "/diagnostics", "/names", "/sat1/ending", "/sat1/host", "/sat1/pose", "/sat1/supply",
        "/sat1/tick", "/sat1/wrench", "/scene", "/supervisor", "/tf", "/truth",
    ]  # fmt: skip
    assert topics["/sat1/ending"]["first_s"] == pytest.approx(2.0)
    assert topics["/supervisor"]["messages"] == 3  # armed, running, stopped
    assert (topics["/tf"]["messages"], topics["/tf"]["kind"]) == (4, "tf2_msgs/TFMessage")
    for topic in (topics[name] for name in ("/sat1/host", "/sat1/tick", "/truth")):
        assert (topic["messages"], topic["gaps"]) == (20, 0)
        assert topic["rate_hz"] == pytest.approx(10.0)
    words = testbed("log", "out/log.mcap").stdout
    assert "/sat1/tick" in words
    assert "Truth" in words


def test_a_log_without_an_end_is_said(testbed, run):
    log = run / "log.mcap"
    log.write_bytes(log.read_bytes()[:9000])
    result = testbed("log", "out")
    assert result.exit_code == 0
    assert "out/log.mcap is cut off at" in result.stderr


@pytest.mark.parametrize("name", ["empty.csv", "empty.mcap"])
def test_an_empty_file_is_not_listed(testbed, name):
    Path(name).touch()
    result = testbed("log", name)
    assert result.exit_code == 2
    assert result.stderr == f"error: {name}: there are no messages in the log\n"


def test_a_file_of_another_kind_is_shown_by_its_beginning(testbed):
    Path("poses.csv").write_text("t_s,x_m,y_m\n")
    result = testbed("log", "poses.csv")
    assert "expected  an MCAP file" in result.stderr
    assert "found     a file that begins with 't_s,x_m,'" in result.stderr


def test_export_writes_files_and_never_over_others(testbed):
    result = testbed("export", "out", "--to", "csv")
    assert result.exit_code == 0
    paths = [Path(line) for line in result.stdout.split()]
    assert {p.name for p in paths} == {
        "sat1_tick.csv", "sat1_host.csv", "truth.csv", "supervisor.csv", "sat1_ending.csv",
        "names.csv",
    }  # fmt: skip
    assert all(p.parent == Path("out/export") and p.stat().st_size > 0 for p in paths)
    assert testbed("export", "out", "--to", "csv").exit_code == 2
    assert testbed("export", "out", "--to", "csv", "--out", "elsewhere").exit_code == 0


def test_a_bag_and_a_matlab_file_are_written_once(testbed):
    for kind, names in (("bag", {"log.mcap", "metadata.yaml"}), ("mat", {"log.mat"})):
        result = testbed("export", "out", "--to", kind, "--out", kind)
        assert result.exit_code == 0
        assert {path.name for path in Path(kind).iterdir()} == names
        assert testbed("export", "out", "--to", kind, "--out", kind).exit_code == 2


def test_what_is_no_log(testbed):
    Path("out/log.mcap").write_bytes(b"nonsense")
    for words in (["log", "out"], ["export", "out", "--to", "npz"]):
        result = testbed(*words)
        assert result.exit_code == 2
        assert result.stderr.startswith("error: ")


def test_a_film_of_a_run(testbed, here):
    pytest.importorskip("PIL", reason="the film extra is not installed")
    testbed("run", "hold", "duration_s=2", "--out", "run")
    made = testbed("film", "run", "--out", "small.gif", "--width", "240", "--speed", "2")
    assert made.stdout == "small.gif\n"
    assert (here / "small.gif").read_bytes().startswith(b"GIF89a")
    (here / "empty").mkdir()
    for words in (["empty"], ["run", "--out", "film.avi"]):
        refused = testbed("film", *words)
        assert refused.exit_code == 2
        assert refused.stderr.startswith("error: ")
