"""`testbed campaign`, `tune`, `bench` as an operator uses them, with real flights of a second."""

import json
import os
import shlex
import signal
import subprocess
from contextlib import suppress
from pathlib import Path

import msgspec
import numpy as np
import psutil
import pytest
import tomli_w

from testbed.campaign import engine
from testbed.campaign.benchmark import score
from testbed.campaign.engine import EngineError, workers
from testbed.campaign.flight import CampaignEnd, open_journal, replay_command
from testbed.campaign.journal import JournalError
from testbed.campaign.result import write_parquet
from testbed.campaign.row import FlownRun
from testbed.campaign.summary import summarise
from testbed.campaign.sweep import load_campaign
from testbed.campaign.trial import fly, fly_with_log
from testbed.campaign.tuning import Trial, judged, load_tuning
from testbed.cli.benchmark import print_scores
from testbed.cli.campaign import print_summary
from testbed.cli.tune import TuningResult, print_result
from testbed.config import dump, find, load
from testbed.core.codes import FaultReport
from testbed.core.extra import pip_install

FILE = """
name = "try"
experiment = "hold"
set = ["duration_s=1", "criteria={settle_s=0.9}", "vehicles.sat1.start=[0.0,0.0,1.57]"]
samples = 15
keep = 1

[[grid]]
name = "law"
cases.quick = []
cases.far = ["vehicles.sat1.start=[0.5,0.0,0.0]"]
"""
SUMMARY = {
    "campaign", "experiment", "runs", "planned", "succeeded", "success_rate",
    "confidence_interval", "confidence", "wall_s", "runs_per_second", "resumed",
}  # fmt: skip


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    (folder / "try.toml").write_text(FILE)
    return folder


def lines(folder: Path) -> int:
    journal = folder / "journal.jsonl"
    return len(journal.read_bytes().splitlines()) if journal.exists() else 0


def wait_for_lines(process: subprocess.Popen, folder: Path, count: int) -> None:
    """Until the journal is so long; the process must still run then."""
    for _ in range(20_000):
        if lines(folder) >= count:
            return
        with suppress(subprocess.TimeoutExpired):
            process.wait(timeout=0.02)
            pytest.fail(f"ended too early: {process.communicate()}")
    pytest.fail("some minutes are enough")


@pytest.mark.parametrize("later_s", [0.0, 0.1, 1.0])
def test_ctrl_c_while_the_workers_start_is_said_in_one_line(start, here, later_s):
    process = start("campaign", "try.toml", "--jobs", "1", "--out", "a", wrapper=("setsid",))
    while not spawned(process):
        assert process.poll() is None, process.communicate()
    with suppress(subprocess.TimeoutExpired):
        process.wait(timeout=later_s)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    _, stderr = process.communicate(timeout=120)
    assert process.returncode == 130
    assert stderr.startswith("interrupted: ")
    assert stderr.count("\n") == 1


def spawned(process: subprocess.Popen[str]) -> bool:
    """Whether a worker's process exists."""
    with suppress(psutil.Error):  # one has ended meanwhile
        below = psutil.Process(process.pid).children(recursive=True)
        return any("spawn_main" in " ".join(one.cmdline()) for one in below)
    return False


@pytest.mark.slow
def test_killed_at_any_moment_it_goes_on_and_nothing_is_lost_or_twice(start, here):
    rng = np.random.default_rng(8)
    for kill in range(5):
        process = start("campaign", "try.toml", "--jobs", str(1 + kill % 2), "--out", "a")
        if kill == 0:
            wait_for_lines(process, here / "a", 1)  # before any run
        else:
            wait_for_lines(process, here / "a", lines(here / "a") + int(rng.integers(1, 4)))
        process.kill()
        process.communicate()

    process = start("campaign", "try.toml", "--jobs", "2", "--out", "a")
    wait_for_lines(process, here / "a", lines(here / "a") + 2)
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=120)
    assert process.returncode == 130
    assert stderr.startswith("interrupted: ")
    assert stderr.endswith("the same command resumes there\n")
    assert stderr.count("\n") == 1

    process = start("campaign", "try.toml", "--jobs", "2", "--out", "a", "--json")
    stdout, stderr = process.communicate(timeout=600)
    assert (process.returncode, stderr) == (0, "")
    summary = json.loads(stdout)
    assert summary.keys() > SUMMARY
    assert (summary["runs"], summary["succeeded"]) == (30, 15)
    assert summary["resumed"] > 5
    low, high = summary["confidence_interval"]
    assert low < 0.5 < high
    assert summary["not_repeatable"] == []
    assert summary["reasons"] == {"failed: settle_s not reached": 15}

    messages = (here / "a" / "journal.jsonl").read_bytes().splitlines()[1:]
    assert sorted(json.loads(m.split(b" ", 1)[1])["k"] for m in messages) == list(range(30))
    kept = here / "a" / "failures" / "run_000001"
    assert {p.name for p in kept.iterdir()} == {
        "config.toml", "log.mcap", "metrics.json", "replay.txt",
    }  # fmt: skip

    process = start("campaign", "try.toml", "--jobs", "1", "--out", "b")
    assert process.communicate(timeout=600)[1] == ""
    for name in ("results.parquet", "base.toml"):
        assert (here / "a" / name).read_bytes() == (here / "b" / name).read_bytes()

    (here / "try.toml").write_text(FILE.replace("samples = 15", "samples = 15\nseed = 1"))
    process = start("campaign", "try.toml", "--out", "a")
    stdout, stderr = process.communicate(timeout=120)
    assert process.returncode == 2
    assert "has changed since these 30 runs were flown" in stderr
    assert "found     `seed` was 0 and is 1" in stderr


@pytest.mark.slow
def test_two_calls_that_end_together_do_not_write_at_once(testbed, here, monkeypatch):
    (here / "try.toml").write_text(FILE.replace("samples = 15", "samples = 1"))
    second = []

    def write_slowly(path, *words):
        with pytest.raises(JournalError) as error, open_journal(campaign, path.parent):
            pass
        second.append(str(error.value))
        write_parquet(path, *words)

    campaign = load_campaign(here / "try.toml")
    monkeypatch.setattr("testbed.cli.campaign.write_parquet", write_slowly)
    result = testbed("campaign", "try.toml", "--out", "a", "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["runs"] == 2
    assert ["another process" in words for words in second] == [True]


@pytest.mark.slow
def test_a_worker_draws_nothing_on_the_terminal(here, monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")  # what rich takes for a terminal
    base = tomli_w.dumps(dump(load(find("hold"), ["duration_s=1"])))
    (kept,) = fly_with_log(base, [(0, ())])
    assert "log.mcap" in kept.files
    assert capsys.readouterr() == ("", "")


@pytest.mark.slow
def test_the_command_of_a_run_repeats_it(start, testbed, here):
    (here / "try.toml").write_text(FILE.replace("samples = 15", "samples = 1"))
    process = start("campaign", "try.toml", "--out", "a")
    assert process.communicate(timeout=600)[1] == ""
    messages = (here / "a" / "journal.jsonl").read_bytes().splitlines()[1:]
    flown = {run["k"]: run for run in (json.loads(m.split(b" ", 1)[1]) for m in messages)}
    replay = here / "a" / "failures" / "run_000001" / "replay.txt"
    words = shlex.split(replay.read_text())
    result = testbed(*words[1:], "--json")
    assert result.exit_code == 1
    vehicle = json.loads(result.stdout)["vehicles"]["sat1"]
    assert {name: flown[1]["columns"][name] for name in vehicle} == vehicle


@pytest.mark.slow
def test_a_detuned_law_is_tuned(start, here):
    (here / "tune.toml").write_text("""
        name = "slow"
        experiment = "hold"
        set = ["duration_s=20", "criteria={}", "controller.bandwidth=0.03"]
        trials = 8
        samples = 1
        proof = 1
        cost = { goal_rms_m = 1000.0 }
        [[gain]]
        key = "controller.bandwidth"
        low = 0.02
        high = 0.6
        log = true
    """)
    process = start("tune", "tune.toml", "--out", "t", "--json")
    stdout, stderr = process.communicate(timeout=600)
    assert (process.returncode, stderr) == (0, "")
    result = json.loads(stdout)
    assert result["start"]["gains"] == [0.03]
    assert result["best"]["cost"] < 0.5 * result["start"]["cost"]
    assert result["best_proof"] < 0.5 * result["start_proof"]
    process = start("check", "t/tuned.toml")
    assert process.communicate(timeout=60)[0].startswith("ok: ")


# What a law does is in the result

LAW = """
import sys

class Mine:
    def __init__(self, what: str):
        self.what = what

    def force(self, own, neighbours, world, t):
        if t >= 0.5:
            exec(self.what)
        return 0.1 * (world.goal.p - own.p) - own.v
"""


@pytest.mark.parametrize(
    ("what", "outcome", "words"),
    [
        ("raise ValueError('boom')", "fault", "boom"),
        ("sys.exit('enough')", "fault", "enough"),
        ("raise ValueError(chr(0xDC80))", "fault", r"\udc80"),
    ],
)
def test_whatever_a_law_does_is_a_result_that_can_be_kept(here, what, outcome, words):
    (here / "law.py").write_text(LAW)
    law = f"controller={{type='python',law='law.py:Mine',parameters={{what={json.dumps(what)}}}}}"
    base = tomli_w.dumps(dump(load(find("hold"), ["duration_s=1", law])))
    run = fly(base, 0, ())
    assert (run.outcome, run.wall_s > 0.0) == (outcome, True)
    assert words in run.reason
    assert json.loads(msgspec.json.encode(run))["reason"] == run.reason
    (kept,) = fly_with_log(base, [(0, ())])
    assert "config.toml" in kept.files


def test_a_full_disk_of_a_worker_is_not_the_result_of_a_run(here, monkeypatch):
    base = tomli_w.dumps(dump(load(find("hold"), ["duration_s=1", "criteria={}"])))
    monkeypatch.setattr("tempfile.tempdir", str(here / "nowhere"))
    run = fly(base, 0, ("seed=3",))
    assert (run.outcome, run.reason) == ("passed", "")


@pytest.mark.slow
def test_what_a_law_prints_is_not_what_the_campaign_says(start, here):
    (here / "law.py").write_text(LAW)
    law = "controller={type='python',law='law.py:Mine',parameters={what='print(t)'}}"
    file = {"name": "loud", "experiment": "hold", "set": ["duration_s=1", "criteria={}", law]}
    (here / "loud.toml").write_text(tomli_w.dumps(file))
    stdout, stderr = start("campaign", "loud.toml", "--json").communicate(timeout=600)
    assert json.loads(stdout)["succeeded"] == 1
    assert "0.6" in stderr


def test_words_in_brackets_are_words(here, capsys):
    (here / "try.toml").write_text(FILE.replace("cases.far", 'cases."[/far]"'))
    campaign = load_campaign(here / "try.toml")
    runs = [FlownRun(k, "passed", columns={"gas_g": 1.0}) for k in range(campaign.count)]
    print_summary(summarise(campaign, "hold", CampaignEnd(runs, 0, 1.0, [])), campaign, runs, here)
    assert "[/far]" in capsys.readouterr().out
    start = Trial(0, [0.1], 1e6, 1, "error: [/boom]")
    print_result(None, TuningResult("t", 1, 0, None, start, 0, None, 0, None, 0, {}), here)
    assert "[/boom]" in capsys.readouterr().out


def test_a_flight_that_ended_in_a_fault_is_named_with_its_seed(here, capsys):
    campaign = load_campaign(here / "try.toml")
    stuck = FaultReport("valve_stuck_closed", "jet 4 gives no thrust", "sat1", "jet_missing")
    more = {"fault_t": 12.3, "fault": stuck}
    runs = [FlownRun(k, "fault", stuck.words, {"gas_g": 1.0}, seed=k, **more) for k in range(12)]
    print_summary(summarise(campaign, "hold", CampaignEnd(runs, 0, 1.0, [])), campaign, runs, here)
    said = capsys.readouterr().out
    assert "  run 7, seed 7: valve_stuck_closed of sat1 at 12.3 s: jet 4" in said
    assert f"\n    {replay_command(campaign, here, 7)}\n" in said
    assert "and 2 more in summary.json" in said


def test_what_is_not_safe_on_other_seeds_is_named(here, capsys):
    tune = {"name": "t", "experiment": "hold", "cost": {"gas_g": 1.0}}
    gain = {"key": "controller.bandwidth", "low": 0.1, "high": 0.6}
    (here / "tune.toml").write_text(tomli_w.dumps({**tune, "gain": [gain]}))
    tuning = load_tuning(here / "tune.toml")
    leak = FaultReport("leak", "3 %", "sat1", "tank_loss")
    more = {"seed": 1_000_004, "fault_t": 2.0, "fault": leak}
    unsafe = FlownRun(0, "fault", leak.words, {"gas_g": 1.0}, **more)
    trial = judged(tuning, 0, [0.1], [unsafe])
    best = msgspec.structs.replace(trial, cost=1.0, broken=0)
    result = TuningResult(
        "t", 1, 1, best, best, 1, 1.0, 0, 1e6, 1, {}, best_proof_reasons=trial.reasons
    )
    print_result(tuning, result, here)
    said = capsys.readouterr().out
    assert "  seed 1000004: leak of sat1 at 2.0 s: 3 %" in said
    assert f"see one: testbed run {here / 'tuned.toml'} --seed SEED" in said


def test_a_run_that_ends_in_a_fault_keeps_seed_and_time(here):
    base = tomli_w.dumps(dump(load(find("hold"))))
    run = fly(base, 3, ["duration_s=3", "faults.battery_low.below=12.5", "seed=9"])
    assert (run.outcome, run.seed) == ("fault", 9)
    assert run.explained(run.reason).startswith("seed 9: battery_low of sat1 at 0.")


# What is wrong is said


@pytest.mark.parametrize("verb", ["campaign", "tune", "benchmark"])
def test_a_file_that_is_not_there(testbed, verb):
    result = testbed(verb, "nothing.toml")
    assert result.exit_code == 2
    assert "no such file" in result.stderr


@pytest.mark.parametrize(
    ("name", "hint"),
    [("hold", 'hold is an experiment; a campaign file has `experiment = "hold"`'),
     ("hold_gains", "configs/campaigns/hold_gains.toml")],
)  # fmt: skip
def test_a_shipped_name_that_is_no_file_gets_a_hint(testbed, name, hint):
    result = testbed("campaign", name)
    assert result.exit_code == 2
    assert hint in result.stderr


def test_a_missing_package_is_named_and_how_to_get_it(testbed, monkeypatch, here):
    import sys

    monkeypatch.setitem(sys.modules, "distributed", None)
    result = testbed("campaign", "try.toml", "--scheduler", "tcp://127.0.0.1:9")
    assert result.exit_code == 2
    assert pip_install("campaign") in result.stderr


def test_bench_says_the_commands_for_a_table(testbed):
    result = testbed("benchmark", "--commands", "--only", "hold")
    assert result.exit_code == 0
    assert result.stdout.count("--out runs/benchmark_standard_table/hold/pd/") == 4


def test_the_commands_name_a_shipped_experiment_and_what_a_table_can_do(testbed, here):
    (here / "b.toml").write_text(
        'name = "b"\ntrouble = ["seed=1"]\ntrouble_hardware = "only the twin"\n[laws]\npd = []\n'
        '[scenarios.s]\nexperiment = "hold"\nhardware = "a card before the lens"\nlaws = ["pd"]\n'
    )
    lines = testbed("benchmark", "b.toml", "--commands").stdout.splitlines()
    commands = [line for line in lines if line and not line.startswith("#")]
    assert commands[0] == "testbed run hold --seed 0 --out runs/benchmark_b_table/s/pd/0"
    assert len(commands) == 4
    said = " ".join(line.removeprefix("#").strip() for line in lines if line.startswith("#"))
    for words in (
        "only the twin",
        "On a table: a card before the lens",
        "--reset",
        "=lab/sat1.toml",
    ):
        assert words in said


def test_bench_scores_folders_into_a_page_and_never_over_the_twins(testbed, here):
    (here / "b.toml").write_text(
        'name = "b"\nsamples = 1\n[laws]\npd = []\n[scenarios.s]\nexperiment = "hold"\n'
        'set = ["duration_s=1", "criteria={}"]\nlaws = ["pd"]\n'
    )
    words = shlex.split(testbed("benchmark", "b.toml", "--commands").stdout, comments=True)[1:]
    assert testbed(*words).exit_code == 0
    Path("runs/benchmark_b_table/s/pdd").mkdir()
    result = testbed("benchmark", "b.toml", "--from", "runs/benchmark_b_table", "--json")
    assert result.exit_code == 0
    record = json.loads(result.stdout)
    assert [(one["rig"], one["passed"]) for one in record["scores"]] == [("twin", 1)]
    assert record["passed_over"][0]["folder"] == "s/pdd"
    assert "did you mean `pd`" in result.stderr
    text = Path("runs/benchmark_b_table/benchmark.md").read_text()
    assert "s/pdd" in text
    again = testbed("benchmark", "b.toml", "--from", "runs/benchmark_b_table")
    assert again.exit_code == 0
    assert Path("runs/benchmark_b_table/benchmark.md").read_text() == text

    Path("twin/s").mkdir(parents=True)
    Path("twin/s/journal.jsonl").write_text("")
    result = testbed("benchmark", "b.toml", "--from", "runs/benchmark_b_table", "--out", "twin")
    assert result.exit_code == 2
    assert "this one holds the twin's benchmark" in result.stderr


def test_no_number_of_the_benchmark_is_cut_in_a_narrow_window(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    runs = [FlownRun(0, "passed", columns={"goal_rms_m": 0.000123, "clearance_m": 1.234567})]
    print_scores([score("a_long_scenario", "a_very_long_law", runs)])
    assert {"0.123", "+1.235", "a_very_long_law", "obstacles"} <= set(
        capsys.readouterr().out.split()
    )


def test_bench_knows_its_scenarios(testbed):
    result = testbed("benchmark", "--only", "holt")
    assert result.exit_code == 2
    assert "hold" in result.stderr


def test_more_workers_than_the_memory_holds_are_refused_before_any_starts(testbed, here):
    with pytest.raises(EngineError) as error, workers(100_000, None):
        pass
    assert "a worker takes 0.3 GB" in str(error.value)
    assert "found     100000" in str(error.value)


TUNING = """name = "t"
experiment = "hold"
cost = { gas_g = 1.0 }
[[gain]]
key = "controller.damping"
low = 0.5
high = 1.0
"""


@pytest.mark.parametrize("verb", ["campaign", "tune"])
def test_refused_workers_leave_no_folder(testbed, here, monkeypatch, verb):
    monkeypatch.setattr(engine, "most_workers", lambda: 2)
    (here / "tune.toml").write_text(TUNING)
    result = testbed(verb, "tune.toml" if verb == "tune" else "try.toml", "--jobs", "3")
    assert result.exit_code == 2
    assert "expected  at most 2" in result.stderr
    assert not (here / "runs").exists()


@pytest.mark.parametrize(("verb", "other"), [("campaign", "tune"), ("tune", "campaign")])
def test_the_other_verb_s_file_is_named(testbed, here, verb, other):
    (here / "tune.toml").write_text(TUNING)
    name = "try.toml" if verb == "tune" else "tune.toml"
    result = testbed(verb, name)
    assert result.exit_code == 2
    assert f"hint      testbed {other} {name}" in result.stderr


@pytest.mark.parametrize("verb", ["campaign", "tune"])
def test_a_file_where_the_folder_should_be(testbed, here, verb):
    if verb == "tune":
        (here / "try.toml").write_text(TUNING)
    (here / "taken").write_text("mine")
    result = testbed(verb, "try.toml", "--out", "taken")
    assert result.exit_code == 2
    assert "expected  a writable folder" in result.stderr
    assert (here / "taken").read_text() == "mine"


@pytest.mark.parametrize("verb", ["campaign", "tune"])
def test_a_folder_of_something_else_is_left_alone(testbed, here, verb):
    other = here / "mine"
    other.mkdir()
    (other / "base.toml").write_text("mine")
    if verb == "tune":
        (here / "try.toml").write_text(TUNING)
    result = testbed(verb, "try.toml", "--out", "mine")
    assert result.exit_code == 2
    assert "expected  a new or empty folder" in result.stderr
    assert [one.name for one in other.iterdir()] == ["base.toml"]
