"""`testbed run`: exit codes, what is printed where, and what the folder of a run holds."""

import json
import os
import re
import resource
import shutil
from pathlib import Path

import pytest

from testbed.config import find, load
from testbed.logs.log_reader import LogReader

pytestmark = pytest.mark.usefixtures("here")

WIRES = {
    "lateness_p99_ms", "pose_to_valve_p50_ms", "pose_to_valve_p99_ms", "commands", "board",
}  # fmt: skip
METRICS = {
    "experiment", "rig", "seed", "completed", "duration_s", "wall_s", "real_time_factor",
    "epoch_ns",
    "contacts", "min_vehicle_distance_m", "criteria", "vehicles", "warnings",
    "phase", "red", "touches", "after",
    "formation", "jets",
}  # fmt: skip
VEHICLE_METRICS = {
    "final_error_m", "settle_s", "track_rms_m", "hold_rms_m", "heading_rms_deg",
    "min_obstacle_distance_m", "impulse_ns", "gas_g", "valve_pulses", "max_force_n",
    "filtered_ns",
}  # fmt: skip
FILES = ["config.toml", "figures", "log.mcap", "metrics.json", "report.html"]
LOST = (  # every body, soon and for good
    "table.mocap.dropout_rate=5", "table.mocap.dropout_s=100", "faults.pose_lost.above=0.5",
)  # fmt: skip
SHORT = "duration_s=3"


def metrics_of(folder: Path) -> dict:
    return json.loads((folder / "metrics.json").read_text())


# Exit codes


def test_0_when_all_criteria_are_met(testbed):
    result = testbed("run", "hold", SHORT, "criteria={}", "--out", "out")
    assert result.exit_code == 0
    assert "passed" in result.stdout
    assert metrics_of(Path("out"))["criteria"] == {
        "max_contacts": True, "clear_of_obstacles": True,
    }  # fmt: skip


def test_1_when_a_criterion_failed_and_it_says_which(testbed):
    result = testbed("run", "hold", SHORT, "--out", "out")
    assert result.exit_code == 1
    assert "failed: settle_s, hold_rms_m (nothing was measured)\n" in result.stdout
    metrics = metrics_of(Path("out"))
    assert metrics["completed"] is True
    assert [name for name, met in metrics["criteria"].items() if not met] == [
        "settle_s", "hold_rms_m",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("overrides", "reason"),
    [
        (LOST, "sat1: pose_lost: no pose for 0."),
        (("flight.gate.max_speed=1e-6",), "sat1: too fast: "),
        (("table.link.delay_s=0.15", "guidance.preview_s=0", "guidance.setpoint_life_s=0.01",
          "table.link.loss=1", "table.link.burst_loss=0", "table.link.burst_enter=0.2",
          "table.link.burst_leave=1", "flight.gate.link_timeout_s=0.05"),
         "sat1: no setpoint for 0."),
    ],
    ids=["cameras", "gate", "link"],
)  # fmt: skip
def test_3_when_a_fault_ends_the_run(testbed, read_log, overrides, reason):
    result = testbed("run", "hold", SHORT, *overrides, "--out", "out")
    assert result.exit_code == 3
    assert "aborted after" in result.stdout
    assert reason in result.stdout
    metrics = metrics_of(Path("out"))
    assert metrics["completed"] is False
    assert metrics["duration_s"] < 3.0
    assert metrics["fault"].startswith(reason)
    messages = read_log(Path("out")).messages
    last = messages["/sat1/tick"][-1][1]
    assert last["outputs"]["fault"]
    assert messages["/sat1/event"][-1][1]["text"] == metrics["fault"]
    assert metrics["fault_report"]["vehicle"] == "sat1"
    assert 0.0 < metrics["fault_t"] <= metrics["duration_s"]
    assert not any(one["on_us"] for one in last["pulses"])  # every valve is shut


@pytest.mark.parametrize(
    "words",
    [
        ["run"],
        ["fly"],
        ["run", "hold", "--seed", "-1"],
        ["run", "hold", "--seed", "x"],
        ["run", "hold", "--seed", "9223372036854775808"],
        ["run", "hold", "--rig", "moon"],
        ["run", "hold", "--nonsense"],
        ["run", "no_such_experiment"],
        ["check"],
        ["schema", "moon"],
    ],
)
def test_2_when_the_command_is_wrong(testbed, here, words):
    result = testbed(*words)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr
    assert list(here.iterdir()) == []


# What is printed


def test_json_prints_the_metrics_and_nothing_else(testbed):
    result = testbed("run", "hold", SHORT, "--json", "--out", "out")
    assert result.exit_code == 1
    assert result.stdout_bytes == Path("out/metrics.json").read_bytes()
    assert result.stderr == ""


@pytest.mark.parametrize("words", [["criteria={}"], LOST, ["--json"]])
def test_no_colours_and_no_progress_without_a_terminal(testbed, words):
    result = testbed("run", "hold", SHORT, *words)
    assert "\x1b" not in result.output
    assert result.stderr == ""


def test_the_table_has_every_vehicle_and_the_limits(testbed):
    result = testbed("run", "zhang2023_table", "duration_s=1", "--out", "out")
    for word in ("sat1", "sat2", "sat3", "<= 90", ">= 0.8", "seed 0", "run folder: out"):
        assert word in result.stdout


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_a_terminal_without_unicode(start, tmp_path, encoding):
    process = start("run", "hold", "duration_s=1", "--out", "out", PYTHONIOENCODING=encoding)
    out, err = process.communicate(timeout=300)
    assert process.returncode == 1, err
    assert err == ""
    assert "tracking RMS" in out


# The folder


def test_metrics_have_the_keys_of_the_contract(testbed):
    testbed("run", "zhang2023_table", "duration_s=1", "--seed", "5", "--out", "out")
    metrics = metrics_of(Path("out"))
    assert set(metrics) == METRICS | WIRES | {"fault", "fault_report", "fault_t"}
    assert {metrics[key] for key in WIRES} == {None}  # there are none
    assert (metrics["experiment"], metrics["rig"], metrics["seed"]) == (
        "zhang2023_table", "twin", 5,
    )  # fmt: skip
    assert metrics["duration_s"] == 1.0
    assert metrics["real_time_factor"] == pytest.approx(1.0 / metrics["wall_s"])
    assert metrics["contacts"] == 0
    assert metrics["min_vehicle_distance_m"] == pytest.approx(1.2, abs=0.01)
    assert list(metrics["vehicles"]) == ["sat1", "sat2", "sat3"]
    five = metrics["formation"]["end"]
    assert five["count"] == 3
    assert five["inner"] == pytest.approx(metrics["min_vehicle_distance_m"] - 0.4, abs=0.01)
    assert metrics["formation"]["error_m"] is None  # each has a goal of its own
    for vehicle in metrics["vehicles"].values():
        assert set(vehicle) == VEHICLE_METRICS
        assert vehicle["settle_s"] is None
        assert vehicle["hold_rms_m"] is None
        assert isinstance(vehicle["valve_pulses"], int)
        assert vehicle["max_force_n"] > 0.0


def test_what_does_not_apply_is_null(testbed):
    testbed("run", "hold", "duration_s=1", "guidance.mode=wrench", "--out", "out")
    metrics = metrics_of(Path("out"))
    assert metrics["min_vehicle_distance_m"] is None
    assert metrics["formation"] is None
    assert metrics["vehicles"]["sat1"]["min_obstacle_distance_m"] is None
    assert metrics["vehicles"]["sat1"]["track_rms_m"] is None
    assert metrics["vehicles"]["sat1"]["heading_rms_deg"] is not None


def rows_of(folder):
    """All rows of a log; the standard messages beside them have the time of day."""
    book = LogReader(Path(folder) / "log.mcap")
    return [row for row in book.read() if "/" not in book.kinds[row.topic]]


@pytest.mark.parametrize(("experiment", "duration"), [("hold", 3), ("zhang2023_table_wrench", 1)])
def test_the_folder_s_config_repeats_the_run(testbed, experiment, duration):
    first = testbed("run", experiment, f"duration_s={duration}", "--seed", "7", "--out", "a")
    again = testbed("run", "a/config.toml", "--out", "b")
    assert again.exit_code == first.exit_code
    assert rows_of("a") == rows_of("b")
    a, b = metrics_of(Path("a")), metrics_of(Path("b"))
    for metrics in (a, b):
        assert metrics.pop("epoch_ns") > 0
        assert metrics.pop("wall_s") > 0.0
        assert metrics.pop("real_time_factor") > 0.0
    assert a == b
    assert load(Path("a/config.toml")) == load(Path("b/config.toml"))
    assert load(Path("a/config.toml")) == load(
        find(experiment), [f"duration_s={duration}", "seed=7"]
    )


def test_another_seed_is_another_run(testbed):
    for seed in ("1", "2"):
        testbed("run", "hold", "duration_s=1", "--seed", seed, "--out", seed)
        assert metrics_of(Path(seed))["seed"] == int(seed)
    assert Path("1/log.mcap").read_bytes() != Path("2/log.mcap").read_bytes()


def test_seed_option_comes_after_overrides(testbed):
    testbed("run", "hold", "duration_s=1", "seed=1", "--seed", "2", "--out", "out")
    assert metrics_of(Path("out"))["seed"] == 2


def test_every_tick_of_every_vehicle_is_in_the_log(testbed, read_log):
    testbed("run", "zhang2023_table", "duration_s=2", "--out", "out")
    log = read_log(Path("out"))
    names = ["sat1", "sat2", "sat3"]
    kinds = ("tick", "host", "ending", *STANDARD)
    assert set(log.messages) == {f"/{n}/{end}" for n in names for end in kinds} | {
        "/truth", "/formation", "/supervisor", "/names", "/tf", "/scene", "/diagnostics",
    }  # fmt: skip
    events = log.messages["/supervisor"]
    phases = [(stamp, event["id"]) for stamp, event in events]
    assert phases == [(0, "ARMED"), (0, "RUNNING"), (2 * 10**9, "STOPPED")]
    stamps = [k * 10**8 for k in range(20)]
    wanted = {"tick": "Tick", "host": "HostTick", "truth": "Truth", "formation": "Formation"}
    for topic, rows in log.messages.items():
        encoding, name = log.schemas[topic]
        assert encoding == "ros2msg"
        if (kind := topic.rpartition("/")[2]) not in wanted:
            continue
        assert name == f"testbed_msgs/msg/{wanted[kind]}"
        every = 10 if topic == "/formation" else 1  # the five elements, once a second
        assert [stamp for stamp, _ in rows] == stamps[::every], topic
    for name in names:
        assert log.messages[f"/{name}/ending"][0][0] == 2 * 10**9
        sequence = [row["outputs"]["seq"] for _, row in log.messages[f"/{name}/tick"]]
        assert sequence == list(range(1, 21))
    ((_, known),) = log.messages["/names"]
    assert known["vehicles"] == names
    assert len(log.messages["/truth"][0][1]["vehicles"]) == 3


STANDARD = ("pose", "wrench", "supply")  # topics of a vehicle with messages of ROS


def test_a_law_on_the_vehicle_has_no_host_topic(testbed, read_log):
    testbed("run", "zhang2023_table_wrench", "duration_s=1", "--out", "out")
    topics = set(read_log(Path("out")).messages)
    assert topics == {
        "/sat1/tick",
        "/sat2/tick",
        "/sat3/tick",
        "/sat1/ending",
        "/sat2/ending",
        "/sat3/ending",
        *(f"/sat{k}/{one}" for k in (1, 2, 3) for one in STANDARD),
        "/truth",
        "/formation",
        "/supervisor",
        "/names",
        "/tf",
        "/scene",
        "/diagnostics",
    }


def test_runs_go_to_runs_by_default(testbed, here):
    for _ in range(2):
        testbed("run", "hold", "duration_s=1")
    folders = sorted((here / "runs").iterdir())
    assert len(folders) == 2
    for folder in folders:
        assert re.fullmatch(r"\d{8}T\d{6}Z_hold(-2)?", folder.name)
        assert sorted(p.name for p in folder.iterdir()) == FILES


def test_an_older_run_is_not_touched(testbed, here):
    testbed("run", "hold", "duration_s=1", "--out", "out")
    before = {p.name: (p.read_bytes(), p.stat().st_mtime_ns) for p in (here / "out").rglob("*.*")}
    result = testbed("run", "hold", "duration_s=2", "--out", "out")
    assert result.exit_code == 2
    assert result.stdout == ""
    assert "expected  a new or empty folder" in result.stderr
    after = {p.name: (p.read_bytes(), p.stat().st_mtime_ns) for p in (here / "out").rglob("*.*")}
    assert after == before


def test_bad_input_makes_no_folder(testbed, here):
    result = testbed("run", "hold", "duration_s=-1", "--out", "out")
    assert result.exit_code == 2
    assert list(here.iterdir()) == []


def test_what_a_rig_refuses_leaves_no_folder(testbed, here):
    result = testbed("run", "hold", "--rig", "bench", "board=unicorn", "--out", "new")
    assert result.exit_code == 2
    assert "host or qemu on the bench" in result.stderr
    assert list(here.iterdir()) == []


@pytest.mark.parametrize("out", ["file", "file/below", "/proc/nowhere"])
def test_a_place_where_no_folder_can_be(testbed, here, out):
    Path("file").write_text("mine")
    result = testbed("run", "hold", "duration_s=1", "--out", out)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert "error: " in result.stderr
    assert Path("file").read_text() == "mine"
    assert [p.name for p in here.iterdir()] == ["file"]


def test_a_full_disk_is_a_fault(testbed):
    testbed("run", "zhang2023_table", "duration_s=1", "--out", "compiled")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, before[1]))  # of any file
    try:
        result = testbed("run", "zhang2023_table", "--out", "out")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert result.exit_code == 3
    assert "aborted after" in result.stdout
    assert "File too large" in result.stdout
    metrics = metrics_of(Path("out"))
    assert metrics["completed"] is False
    assert metrics["fault"].startswith("log: ")


@pytest.mark.parametrize("out", ["locked", "locked/below"])
def test_a_folder_that_may_not_be_written(start, here, out):
    locked = here / "locked"
    locked.mkdir(mode=0o555)
    wrapper = []
    if os.geteuid() == 0:  # whom no mode stops, unless the capability is taken away
        if (setpriv := shutil.which("setpriv")) is None:
            pytest.skip("root without setpriv cannot be kept out of a folder")
        wrapper = [setpriv, "--bounding-set=-dac_override,-dac_read_search", "--inh-caps=-all"]
    process = start("run", "hold", "duration_s=1", "--out", out, wrapper=wrapper)
    stdout, stderr = process.communicate(timeout=300)
    assert process.returncode == 2, stderr
    assert stdout == ""
    assert stderr.startswith("error: ")
    assert "Permission denied" in stderr
    assert "Traceback" not in stderr
    assert list(locked.iterdir()) == []


@pytest.mark.parametrize("words", [["--port", "9000"], ["--bind", "0.0.0.0"]])
def test_a_port_of_the_dashboard_needs_a_dashboard(testbed, words):
    result = testbed("run", "hold", *words)
    assert result.exit_code == 2
    assert "--web or --view" in result.stderr
    assert not Path("runs").exists()


def test_the_dashboard_of_a_run_listens_where_it_was_asked_to(testbed, tmp_path, monkeypatch):
    opened = []

    class Board:
        def terminate(self): ...

        wait = terminate

    def beside_run(*where):
        opened.append(where)
        return Board()

    monkeypatch.setattr("testbed.cli.dash.beside_run", beside_run)
    out = tmp_path / "out"
    where = ("--web", "--bind", "0.0.0.0", "--port", "9000", "--speed", "1000")
    testbed("run", "hold", "duration_s=0.5", *where, "--out", out)
    assert opened == [(out, "web", "0.0.0.0", 9000)]
