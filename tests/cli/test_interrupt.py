"""Ctrl-C or SIGTERM at any moment: exit code 130, and a run folder that can be read."""

import json
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

from testbed.cli import run
from testbed.cli.main import entry
from testbed.config import load
from testbed.flight.loop import Ending
from testbed.realtime.heartbeat import heartbeat
from testbed.rig.twin import TwinRig
from testbed.run import fly as flying
from testbed.run.interrupt import Interrupt

pytestmark = pytest.mark.usefixtures("here")

SIGNALS = [signal.SIGINT, signal.SIGTERM]
FOR_EVER = "duration_s=4000"  # half a minute at least


@pytest.fixture
def stray() -> list[int]:
    """Signals that the command did not handle; without this they would end the tests."""
    seen: list[int] = []
    before = {n: signal.signal(n, lambda number, frame: seen.append(number)) for n in SIGNALS}
    yield seen
    for number, handler in before.items():
        signal.signal(number, handler)


def exit_code(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    """Of the command as a program, in this process."""
    monkeypatch.setattr(sys, "argv", ["testbed", *words])
    with pytest.raises(SystemExit) as ended:
        entry()
    return ended.value.code


def assert_incomplete(folder: Path, read_log) -> dict:
    """The folder is readable and says that the run did not reach its end."""
    assert sorted(p.name for p in folder.iterdir()) == [
        "config.toml", "figures", "log.mcap", "metrics.json", "report.html",
    ]  # fmt: skip
    assert load(folder / "config.toml").name
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["completed"] is False
    assert metrics["fault"] is None
    assert metrics["criteria"] is None  # not judged
    page = (folder / "report.html").read_text()
    assert f"interrupted at {metrics['duration_s']:.1f} s: not judged" in page
    assert "not met" not in page
    assert 'class="missed"' not in page
    read_log(folder)
    return metrics


# At a chosen moment, in this process


def interrupt_before(monkeypatch, where: str, number: int, times: int = 1) -> None:
    """Send a signal just before a function of `testbed run` starts."""
    owner, _, name = where.rpartition(".")
    module = flying if owner or name in ("warm_up", "measure") else run
    place = getattr(module, owner) if owner else module
    original: Callable = getattr(place, name)

    def interrupted(*args, **kwargs):
        for _ in range(times):
            signal.raise_signal(number)
        monkeypatch.setattr(place, name, original)
        return original(*args, **kwargs)

    monkeypatch.setattr(place, name, interrupted)


@pytest.mark.parametrize("number", SIGNALS)
@pytest.mark.parametrize(
    "moment",
    ["write_config", "make_twin", "Recorder.__enter__", "warm_up", "FlightLog.vehicle",
     "FlightLog.host", "FlightLog.done"],
)  # fmt: skip
@pytest.mark.parametrize("experiment", ["hold", "zhang2023_table"])
def test_before_the_end(monkeypatch, stray, read_log, experiment, moment, number):
    interrupt_before(monkeypatch, moment, number)
    assert exit_code(monkeypatch, "run", experiment, "duration_s=1", "--out", "out") == 130
    assert stray == []
    metrics = assert_incomplete(Path("out"), read_log)
    assert metrics["duration_s"] < 1.0


@pytest.mark.parametrize("moment", ["measure", "write_metrics", "print_result"])
@pytest.mark.parametrize("number", SIGNALS)
def test_after_the_end(monkeypatch, stray, read_log, moment, number):
    interrupt_before(monkeypatch, moment, number)
    code = exit_code(monkeypatch, "run", "hold", "duration_s=1", "criteria={}", "--out", "out")
    assert code in (0, 130)
    assert json.loads(Path("out/metrics.json").read_text())["completed"] is True
    assert len(read_log(Path("out")).messages["/sat1/tick"]) == 10


def test_an_impatient_operator(monkeypatch, stray, read_log):
    interrupt_before(monkeypatch, "FlightLog.vehicle", signal.SIGINT, times=5)
    assert exit_code(monkeypatch, "run", "hold", "duration_s=1", "--out", "out") == 130
    assert_incomplete(Path("out"), read_log)


def test_while_the_input_is_read(monkeypatch, here):
    def interrupted(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr(run, "load", interrupted)
    assert exit_code(monkeypatch, "run", "hold", "--out", "out") == 130
    assert list(here.iterdir()) == []


IN_A_CALLBACK = """\
import ctypes
import time

@ctypes.CFUNCTYPE(None)
def called_by_a_compiler():
    open("there", "w").close()
    time.sleep(60)

called_by_a_compiler()

class Mine:
    def force(self, own, neighbours, world, t):
        return [0.0, 0.0]
"""


def test_in_a_callback_while_the_input_is_read(start, here):
    """Python drops an exception there, so the run would be flown."""
    Path("my_law.py").write_text(IN_A_CALLBACK)
    law = "controller={type='python',law='my_law.py:Mine'}"
    process = start("run", "hold", law, "duration_s=1", "--out", "out")
    wait_for(process, Path("there").exists)
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=60)
    assert (process.returncode, stdout, stderr) == (130, "", "")
    assert not Path("out").exists()


@pytest.mark.parametrize("verb", ["run", "check"])
def test_while_modules_are_imported(start, here, verb):
    process = start(verb, "hold")
    looks = psutil.Process(process.pid)
    wait_for(process, lambda: len(looks.children()) > 0)
    looks.children()[0].send_signal(signal.SIGINT)  # as a terminal does, to both
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=60)
    assert (process.returncode, stdout, stderr) == (130, "", "")
    assert list(here.iterdir()) == []


IN_AN_IMPORT = """\
import signal
import sys
import weakref

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "testbed.cli.main":
            one = Finder()
            kept = weakref.ref(one, lambda _: signal.raise_signal(signal.SIGINT))
            del one

sys.meta_path.insert(0, Finder())
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's `&` has Ctrl-C ignored
sys.argv = ["testbed", "list"]
from testbed.cli.start import entry
entry()
"""


def test_in_a_callback_of_an_import():
    """Python drops an exception there, so the verb would go on."""
    done = subprocess.run(
        [sys.executable, "-c", IN_AN_IMPORT], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_after_a_run_a_signal_does_not_kill_its_process(stray):
    """Its files are there, and its exit code has to be reported."""
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        with Interrupt().caught():
            pass
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)


def test_handlers_are_put_back(monkeypatch):
    before = [signal.getsignal(number) for number in SIGNALS]
    exit_code(monkeypatch, "run", "hold", "duration_s=1")
    assert [signal.getsignal(number) for number in SIGNALS] == before


# In a process of its own


def wait_for(process: subprocess.Popen, condition: Callable[[], bool]) -> None:
    """Until `condition`; the process must still run then."""
    for _ in range(6000):
        if condition():
            return
        with suppress(subprocess.TimeoutExpired):
            process.wait(timeout=0.02)
            pytest.fail(f"ended too early: {process.communicate()}")
    pytest.fail("two minutes are enough")


@pytest.mark.parametrize("number", SIGNALS)
def test_in_flight(start, here, read_log, number):
    process = start("run", "zhang2023_table", FOR_EVER, "--out", "out")
    log = here / "out" / "log.mcap"
    wait_for(process, lambda: log.exists() and log.stat().st_size > 100_000)
    process.send_signal(number)
    stdout, stderr = process.communicate(timeout=30)
    assert process.returncode == 130, stderr
    assert stderr == ""
    assert re.search(r"interrupted at \d+\.\d s: not judged", stdout)
    metrics = assert_incomplete(here / "out", read_log)
    assert metrics["duration_s"] > 1.0
    messages = read_log(here / "out").messages
    endings = {topic: rows for topic, rows in messages.items() if topic.endswith("/ending")}
    each = ("/tick", "/host", "/truth")  # the others have a pace of their own
    ticks = {topic: rows for topic, rows in messages.items() if topic.endswith(each)}
    assert {len(rows) for rows in ticks.values()} == {len(ticks["/truth"])}
    assert ticks["/truth"][-1][0] * 1e-9 == pytest.approx(metrics["duration_s"] - 0.1)
    for rows in endings.values():  # the vehicles brake and land then
        assert rows[0][0] * 1e-9 == pytest.approx(metrics["duration_s"])
        assert rows[-1][1]["outputs"]["air_off"] == 1
    assert len(endings) == 3
    assert (metrics["after"]["contacts"], metrics["after"]["air"]) == (0, "off")


def test_what_the_compiler_hands_over_is_kept():
    """Python drops an exception that is raised in a callback, and the callback's work."""
    interrupt, kept = Interrupt(), []

    def _raw_object_cache_notify():  # as llvmlite's
        signal.raise_signal(signal.SIGINT)
        kept.append("machine code")

    with interrupt.caught(), interrupt.at_once():
        _raw_object_cache_notify()
        threading.Event().wait(60.0)  # until the exception
        kept.append("nothing was raised")
    assert kept == ["machine code"]
    assert interrupt.asked == 1


@pytest.mark.parametrize("number", SIGNALS)
def test_while_it_compiles(start, here, read_log, tmp_path, number):
    process = start(
        "run", "zhang2023_table", FOR_EVER, "--json", "--out", "out",
        XDG_CACHE_HOME=str(tmp_path / "nothing compiled yet"),
    )  # fmt: skip
    wait_for(process, (here / "out" / "log.mcap").exists)
    process.send_signal(number)
    stdout, stderr = process.communicate(timeout=180)  # LLVM cannot be interrupted
    assert process.returncode == 130, stderr
    metrics = assert_incomplete(here / "out", read_log)
    assert metrics["duration_s"] == 0.0
    assert json.loads(stdout) == metrics


def test_a_process_that_does_not_obey_is_killed_and_its_run_finished(start, here, read_log):
    process = start("run", "hold", FOR_EVER, "--speed", "1", "--out", "out")
    log = here / "out" / "log.mcap"
    wait_for(process, lambda: log.exists() and log.stat().st_size > 20_000)
    for child in psutil.Process(process.pid).children():
        child.suspend()
    process.send_signal(signal.SIGTERM)
    stdout, stderr = process.communicate(timeout=120)
    assert process.returncode == 130, stderr
    killed = "warning: the run's process did not obey the stop, and was killed"
    assert stderr.splitlines()[-1] == killed  # after the flight's status
    assert "interrupted at" in stdout
    metrics = json.loads((here / "out" / "metrics.json").read_text())
    assert (metrics["completed"], metrics["fault"]) == (False, None)
    assert (here / "out" / "report.html").exists()
    read_log(here / "out")


def test_a_flight_shows_that_it_lives_whenever_it_asks_for_a_stop(monkeypatch):
    beats = []

    def waits(self, observer, stopped):  # as for vehicles on wires
        for _ in range(3):
            beats.append(heartbeat().beats)
            stopped()
        return Ending(0.0, None)

    monkeypatch.setattr(TwinRig, "fly", waits)
    assert exit_code(monkeypatch, "run", "hold") == 130
    assert len(set(beats)) == 3


def test_a_killed_run_leaves_a_log(start, here, read_log):
    process = start("run", "zhang2023_table", FOR_EVER, "--out", "out")
    log = here / "out" / "log.mcap"
    wait_for(process, lambda: log.exists() and log.stat().st_size > 100_000)
    process.kill()
    process.communicate()
    assert not (here / "out" / "metrics.json").exists()  # which is how it is marked incomplete
    load(here / "out" / "config.toml")
