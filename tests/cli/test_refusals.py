"""What an operator reads who typed something wrong, or whose disk is full."""

import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from msgspec.structs import replace

from testbed.cli import refusal
from testbed.cli.main import entry, main
from testbed.cli.result import _verdict
from testbed.config import find, load
from testbed.config.shipped import shipped
from testbed.report.page import read_metrics

VERBS = sorted(main.commands)


@pytest.fixture
def flown(testbed, here):
    testbed("run", "hold", "duration_s=1", "--out", "flown")
    return here / "flown"


# help


@pytest.mark.parametrize("verb", ["", *VERBS])
def test_help_fits_a_terminal_of_80_columns(testbed, monkeypatch, verb):
    monkeypatch.setenv("COLUMNS", "80")
    text = testbed(*[verb][: bool(verb)], "--help").stdout
    assert [line for line in text.splitlines() if len(line) > 80] == []
    assert "..." not in text.replace("[ARGS]...", "").replace("VALUE]...", "").replace(
        "RUNS...", ""
    ).replace("LOGS...", "")


@pytest.mark.parametrize("verb", VERBS)
def test_every_option_says_what_it_is_for(verb):
    options = [p for p in main.commands[verb].params if p.param_type_name == "option"]
    assert [p.name for p in options if not p.hidden and not p.help] == []


def test_help_has_the_exit_codes(testbed):
    text = " ".join(testbed("--help").stdout.split())
    assert "2 bad input" in text
    assert "4 not armed" in text


# the wrong file


@pytest.mark.parametrize("words", [["log"], ["replay"], ["report"], ["compare"], ["dash", "--web"],
                                   ["export", "--to", "csv"]])  # fmt: skip
def test_a_folder_that_is_none_of_a_run(testbed, here, words):
    (here / "empty").mkdir()
    result = testbed(*words, "empty")
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr == (
        "error: empty\n  expected  a run folder, with a log.mcap and a config.toml in it\n"
        "  found     neither\n"
    )
    assert list((here / "empty").iterdir()) == []


def test_a_run_folder_for_an_experiment(testbed, flown):
    result = testbed("check", "flown")
    assert "its experiment is flown/config.toml" in result.stderr
    assert testbed("check", "flown/config.toml").exit_code == 0


def test_an_experiment_without_its_ending(testbed, flown):
    assert "did you mean `flown/config.toml`?" in testbed("check", "flown/config").stderr


@pytest.mark.parametrize(
    ("file", "kind"),
    [("vehicles/generic_8jet", "vehicle"), ("tables/marble_6m", "table"),
     ("benchmark", "benchmark"), ("campaigns/hold_gains", "campaign"),
     ("campaigns/tune_hold_pd", "campaign")],
)  # fmt: skip
def test_another_kind_of_file_for_an_experiment(testbed, file, kind):
    path = Path(__file__).resolve().parents[2] / "configs" / f"{file}.toml"
    assert f": the file of a {kind}" in testbed("check", path).stderr


def test_text_without_quotes(testbed):
    result = testbed("check", "hold", "table.lab.mocap.server=10.0.0.9")
    assert "text in quotes" in result.stderr
    assert testbed("check", "hold", 'table.lab.mocap.server="10.0.0.9"').exit_code == 0


# what cannot be written


def test_nothing_is_exported_over(testbed, flown):
    assert testbed("export", "flown", "--to", "npz").exit_code == 0
    result = testbed("export", "flown", "--to", "npz")
    assert result.exit_code == 2
    assert "flown/export/log.npz\n" in result.stderr
    assert "name another with --out" in result.stderr


@pytest.mark.parametrize("words", [["list"], ["schema"], ["check", "hold"]])
def test_a_full_disk_behind_the_output(words):
    code = "from testbed.cli.main import entry; entry()"
    with open("/dev/full", "w") as full:  # noqa: PTH123
        result = subprocess.run(
            [sys.executable, "-c", code, *words], stdout=full, stderr=subprocess.PIPE, text=True,
            check=False, env=os.environ | {"PYTHONUNBUFFERED": ""},
        )  # fmt: skip
    assert result.stderr.startswith("error: standard output\n")
    assert "No space left on device" in result.stderr
    assert "Traceback" not in result.stderr
    assert result.returncode == 2


def test_a_fault_of_this_software_is_no_verdict_on_a_flight(monkeypatch, capsys):
    from testbed.cli import inspection

    def broken(as_json):
        raise RuntimeError("nobody thought of this")

    monkeypatch.setattr(inspection, "list_everything", broken)
    monkeypatch.setattr(sys, "argv", ["testbed", "list"])
    with pytest.raises(SystemExit) as ended:
        entry()
    said = capsys.readouterr().err
    assert ended.value.code == 70
    assert "RuntimeError: nobody thought of this" in said
    assert "error: internal error; your files are not the cause" in said


def test_a_verdict_stands_without_its_report(testbed, here, monkeypatch):
    from testbed.cli import run
    from testbed.report.page import ReportError

    def full(folder, experiment, warn):
        raise ReportError("out/figures: No space left on device")

    monkeypatch.setattr(run, "write_page", full)
    result = testbed("run", "hold", "duration_s=1", "criteria={}", "--out", "out")
    assert result.exit_code == 0
    assert "passed: all criteria met" in result.stdout
    assert "warning: no report: out/figures: No space left" in result.stderr
    assert "testbed report out" in result.stderr


# words of the result


def test_brackets_in_a_fault_are_shown(testbed, here):
    """A table file's section, say: brackets are markup to what prints the result."""
    testbed("run", "hold", "duration_s=1", "--out", "out")
    metrics = replace(read_metrics(here / "out"), fault="see [lab.network] of the table file")
    assert _verdict(load(find("hold")), metrics).endswith(r"see \[lab.network] of the table file")


def test_a_criterion_that_was_not_measured_says_so(testbed, here):
    result = testbed("run", "hold", "duration_s=1", "--out", "out")
    assert result.exit_code == 1
    assert "hold_rms_m (nothing was measured)" in " ".join(result.stdout.split())
    assert "settle_s (nothing" not in result.stdout


@pytest.mark.parametrize("limit", ["settle_s=90", "hold_rms_m=10.0"])
def test_a_criterion_of_a_goal_that_rests_is_not_measured_on_a_path(testbed, here, limit):
    """A point where the goal has been says nothing, however near it is."""
    circle = str(shipped("scenarios")["circle"])
    asked = [f"criteria={{{limit}}}", "duration_s=31"]
    result = testbed("run", circle, "vehicles.sat1.path.radius=0.01", *asked, "--out", "out")
    assert result.exit_code == 1
    name = limit.partition("=")[0]
    assert f"failed: {name} (nothing was measured)" in " ".join(result.stdout.split())
    assert "(nothing was measured)" in (here / "out/report.html").read_text()


def test_one_vehicle_is_one(testbed):
    assert "  1 vehicle, 0 obstacles, law pd" in testbed("check", "hold").stdout
    assert "  3 vehicles, 2 obstacles, law" in testbed("check", "zhang2023_table").stdout


def test_events_have_neither_rate_nor_gaps(testbed, flown, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    row = next(line for line in testbed("log", "flown").stdout.splitlines() if "Event" in line)
    assert row.split()[3] == "-"
    assert row.split()[5:7] == ["0", "-"]


def test_names_of_runs_are_never_cut(testbed, flown, monkeypatch):
    monkeypatch.setenv("COLUMNS", "60")
    names = [f"a_run_with_a_long_name_that_ends_in_{k}" for k in range(2)]
    for name in names:
        shutil.copytree(flown, name)
    text = testbed("compare", *names).stdout
    assert [f"  {k}  {name}" for k, name in enumerate(names, 1)] == text.splitlines()[:2]
    assert "\N{HORIZONTAL ELLIPSIS}" not in text


# long messages


def test_a_message_is_broken_between_words_at_a_terminal(monkeypatch):
    monkeypatch.setattr(refusal.errors, "_force_terminal", True)
    monkeypatch.setattr(refusal.errors, "_width", 40)
    text = (
        "error: hodl\n  expected  one of: alpha, bravo, charlie, delta, echo\n  found     nothing"
    )
    assert refusal.laid_out(text).splitlines() == [
        "error: hodl",
        "  expected  one of: alpha, bravo,",
        "            charlie, delta, echo",
        "  found     nothing",
    ]


def test_a_message_in_a_pipe_keeps_its_lines():
    text = "error: x\n  expected  " + "word " * 50
    assert refusal.laid_out(text) == text


# an agent whose host is not there


def test_an_agent_that_looks_for_its_host_hears_an_interrupt(start):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"  # bound, but nobody listens
        process = start("agent", "sat1", "--connect", endpoint)
        assert f"sat1: looking for the host at {endpoint}" in process.stderr.readline()
        process.terminate()  # the same as Ctrl-C, and heard when tests run in the background, too
        process.communicate(timeout=40)  # less than the minute that it waits for a host
    assert process.returncode == 130


def test_a_reader_that_has_seen_enough_is_no_error():
    reader, writer = os.pipe()
    os.close(reader)
    code = "from testbed.cli.main import entry; entry()"
    result = subprocess.run(
        [sys.executable, "-c", code, "benchmark", "--commands"], stdout=writer,
        stderr=subprocess.PIPE, text=True, check=False, env=os.environ | {"PYTHONUNBUFFERED": ""},
    )  # fmt: skip
    os.close(writer)
    assert result.stderr == ""
    assert result.returncode == 1


# keys: what to do next


def test_keys_say_what_is_to_be_carried(testbed, here):
    pytest.importorskip("cryptography")
    first = testbed("lab-keys", "keys", "--host", "127.0.0.1", "--vehicle", "sat1")
    assert "Copy each folder to its machine" in first.stdout
    more = testbed("lab-keys", "keys", "--watcher", "wall")
    assert "Copy keys/host to the host again" in more.stdout
    assert "Copy every folder" in testbed("lab-keys", "keys", "--renew").stdout
    assert "Copy" not in testbed("lab-keys", "keys").stdout


def test_a_run_without_criteria_did_not_pass(testbed, here):
    testbed("run", "hold", "duration_s=1", "--out", "judged")
    metrics = read_metrics(here / "judged")
    hold = load(find("hold"))
    assert "passed" in _verdict(hold, replace(metrics, criteria={"max_contacts": True}))
    assert _verdict(hold, replace(metrics, criteria={})) == "[bold]no criteria to judge[/]"


@pytest.mark.parametrize("speed", ["nan", "inf"])
def test_a_speed_is_finite(testbed, here, speed):
    for words in (["run", "hold"], ["film", "."], ["ros2", "."]):
        result = testbed(*words, "--speed", speed)
        assert result.exit_code == 2
        assert f"{speed} is not a finite number" in result.stderr
    assert list(here.iterdir()) == []
