"""A law that hangs, exits, forks or dies ends the run as a fault that names it.

`benchmarks/misbehaving_laws.py` tries all of them on the twin and on the bench.
"""

import json
import os
import signal
import subprocess
import sys
import textwrap
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

from patience import wait_for
from testbed.config import find, load
from testbed.realtime import law_watch
from testbed.rig.twin import warm_up

pytestmark = pytest.mark.usefixtures("compiled", "here")


@pytest.fixture(scope="module")
def compiled():
    """The machine code of these runs: a test must not wait while another process compiles."""
    warm_up(load(find("hold")))


LAW = """
import os, signal, subprocess, sys, threading, time
import numba
import numpy as np

@numba.njit
def spin(n):
    while n > 0:
        n += 1 - (n & 1)
    return n

spin(0)  # compiled here


class Mine:
    step_s = 0.02

    def force(self, own, neighbours, world, t):
        if t > 1.5:
            {does}
        return np.zeros(2)
"""


def law(does: str) -> str:
    """A file whose law does this after a second and a half; the override that flies it."""
    Path("my_law.py").write_text(LAW.format(does=does))
    return 'controller={type="python",law="my_law.py:Mine"}'


def at_import(does: str) -> str:
    """The same for a file that does it while it is read."""
    Path("my_law.py").write_text("import os, sys, time\n" + textwrap.dedent(does))
    return 'controller={type="python",law="my_law.py:Mine"}'


def words(override: str, *more: str) -> list[str]:
    return ["run", "hold", "duration_s=5", "criteria={}", override, *more, "--out", "out"]


def fault_of(process: subprocess.Popen, code: int = 3) -> str:
    """What metrics.json calls it, of a run that has everything a run has."""
    said, errors = process.communicate(timeout=120)
    assert process.returncode == code, said + errors
    metrics = json.loads(Path("out/metrics.json").read_text())
    assert metrics["completed"] is False
    assert metrics["rig"] == "twin"
    assert Path("out/report.html").exists()
    assert "aborted" in said
    return metrics["fault"]


SOON = "deploy.law_limit_s=0.4"


@pytest.mark.parametrize(
    ("does", "fault"),
    [
        ("while True: pass", "my_law.py:20, in force: did not return within 0.4 s"),
        ("time.sleep(1000)", "my_law.py:20, in force: did not return within 0.4 s"),
        ("sys.exit(0)", "my_law.py:20, in force: called sys.exit(0)"),
        ("os.fork()", "my_law.py: started a process by os.fork(); a law must not"),
        (
            "subprocess.Popen(['sleep', '1000'])",
            "my_law.py:20, in force: started a process by subprocess.Popen; a law must not",
        ),
        (
            "os.system('sleep 1000')",
            "my_law.py:20, in force: started a process by os.system; a law must not",
        ),
        (
            "return np.zeros(2) + 1j",
            "my_law.py:18, in force at 1.508 s: expected a force [N]: finite real numbers of shape "
            "(2,), found array([0.+1.j, 0.+1.j]); take the real part, or look for the square root "
            "of a negative number",
        ),
        ("raise KeyboardInterrupt", "my_law.py:20, in force: KeyboardInterrupt: "),
        (
            r"raise ValueError('\x00\x1b[2J\udcff' + 200 * 'x')",
            rf"my_law.py:20, in force: ValueError: \x00\x1b[2J\udcff{200 * 'x'}",
        ),
        (
            "raise type('Odd', (Exception,), {'__str__': lambda self: 1 / 0})()",
            "my_law.py:20, in force: Odd: its text cannot be read: ZeroDivisionError",
        ),
    ],
)
def test_what_can_be_interrupted_is_blamed_line_by_line(testbed, does, fault):
    # a fork of a large process takes its time on a busy machine
    limit = "deploy.law_limit_s=5" if "fork" in does else SOON
    result = testbed(*words(law(does), limit))
    assert result.exit_code == 3, result.output
    metrics = json.loads(Path("out/metrics.json").read_text())
    assert metrics["fault"] == f"sat1: law on the host: LawError: {fault}"
    assert metrics["vehicles"]["sat1"]["gas_g"] > 0.0
    assert Path("out/report.html").exists()


@pytest.mark.parametrize(
    ("does", "fault"),
    [
        ("os._exit(0)", "ended its process with exit code 0"),
        ("os.kill(os.getpid(), signal.SIGKILL)", "ended its process by SIGKILL, as the system"),
        ("spin(1)", "did not return within 1 s"),
    ],
)
def test_what_takes_its_process_along_is_named_by_the_other_one(start, does, fault):
    found = fault_of(start(*words(law(does), SOON)))
    assert found.startswith(f"law of sat1 (my_law.py) {fault}")


def test_one_that_takes_too_much_memory_is_named(testbed):
    does = "self.kept = [*getattr(self, 'kept', []), np.ones(1_000_000)]"
    result = testbed(*words(law(does), "deploy.law_memory_mb=50"))
    assert result.exit_code == 3, result.output
    fault = json.loads(Path("out/metrics.json").read_text())["fault"]
    assert "my_law.py:" in fault
    assert "its calls have taken" in fault


def test_threads_that_do_not_end_are_a_fault_and_the_command_ends(start):
    does = "threading.Thread(target=time.sleep, args=(1000,), name='mine').start(); t = -1e9"
    once = f"if not hasattr(self, 'one'): self.one = 1; {does}"
    found = fault_of(start(*words(law(once))))
    assert found == "law my_law.py has left a thread running: mine"


def test_what_a_file_has_started_does_not_outlive_the_run(start):
    override, file = law("os._exit(0)"), Path("my_law.py")
    starts = "open('pid', 'a').write(f'{subprocess.Popen([\"sleep\", \"1000\"]).pid}\\n')"
    file.write_text(f"{file.read_text()}\n{starts}\n")
    fault_of(start(*words(override)))
    started = [int(pid) for pid in Path("pid").read_text().split()]
    assert started
    assert not any(map(psutil.pid_exists, started))


def test_a_law_that_kills_the_log_writer_is_blamed_all_the_same(start):
    kills = (
        "[os.kill(one.pid, 9) for one in psutil.Process().children()"
        " if 'mcap_writer' in ' '.join(one.cmdline())]; [][0]"
    )
    override, file = law(kills), Path("my_law.py")
    file.write_text(f"import psutil\n{file.read_text()}")
    fault = fault_of(start(*words(override)))
    assert "my_law.py:21, in force: IndexError" in fault
    assert "; log: " in fault


@pytest.mark.parametrize(("nap", "warned", "code"), [(0.003, 0, 0), (0.025, 1, 0), (0.06, 1, 3)])
def test_a_slow_law_is_flown_on_the_twin_and_named(testbed, nap, warned, code):
    override = law(f"time.sleep({nap})")  # three times in a jet period
    Path("my_law.py").write_text(Path("my_law.py").read_text().replace("t > 1.5", "True"))
    result = testbed(*words(override, "duration_s=1", "flight.jet_period_s=0.05"))
    assert result.exit_code == code, result.output
    metrics = json.loads(Path("out/metrics.json").read_text())
    assert metrics["duration_s"] == 1.0
    said = [one["text"] for one in metrics["warnings"] if one["name"] == "slow_law"]
    assert len(said) == warned
    said += [f"sat1: {metrics['fault']}"] if code else []
    for one in said:
        assert one.startswith("sat1: law my_law.py takes ")
        assert one.endswith("times the 0.05 s that it has on the bench and on the table")


# While its file is read


@pytest.mark.parametrize(
    ("does", "found"),
    [
        ("sys.exit(0)", "my_law.py:2, in <module>: called sys.exit(0)"),
        ("while True: pass", "my_law.py:2, in <module>: did not return within 0.2 s"),
        ("os.fork()\nclass Mine:\n  def force(self, own, neighbours, world, t): return own.p",
         "my_law.py: started a process by os.fork(); a law must not"),
    ],
)  # fmt: skip
def test_a_file_that_misbehaves_while_it_is_read_is_refused(
    testbed, here, monkeypatch, does, found
):
    if "did not return" in found:  # else a busy machine may take longer, for instance to fork
        monkeypatch.setattr(law_watch, "READ_S", 0.2)
    result = testbed(*words(at_import(does)))
    assert result.exit_code == 2, result.output
    assert "key       controller.law" in result.stderr
    assert f"found     {found}" in result.stderr
    assert not (here / "out").exists()


@pytest.mark.parametrize("verb", ["run", "check"])
def test_a_file_that_ends_the_process_is_refused(start, here, verb):
    process = start(verb, "hold", at_import("os._exit(0)"))
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 2
    assert "law my_law.py ended its process with exit code 0" in errors
    assert not (here / "runs").exists()


# Signals


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_a_run_whose_law_hangs_in_compiled_code(start, number):
    process = start(*words(law("open('there', 'w').close(); spin(1)"), "deploy.law_limit_s=1000"))
    wait_for(Path("there").exists)
    process.send_signal(number)
    assert "did not return after the stop" in fault_of(process)


def test_a_closed_terminal_ends_a_run_in_order(start, read_log):
    process = start("run", "hold", "duration_s=4000", "--speed", "1", "--out", "out")
    log = Path("out/log.mcap")
    wait_for(lambda: log.exists() and log.stat().st_size > 20_000)
    process.send_signal(signal.SIGHUP)
    said, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert "interrupted at" in said
    assert Path("out/report.html").exists()
    read_log(Path("out"))


def test_a_terminal_that_is_gone_does_not_keep_the_report_from_being_made(here):
    leader, terminal = os.openpty()
    env = os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    run = subprocess.Popen(
        [sys.executable, "-m", "testbed", "run", "hold", "duration_s=4000", "--speed", "1",
         "--out", "out"],
        stdin=terminal, stdout=terminal, stderr=terminal, env=env, start_new_session=True,
        preexec_fn=lambda: __import__("fcntl").ioctl(0, __import__("termios").TIOCSCTTY, 0),
    )  # fmt: skip
    os.close(terminal)
    log = Path("out/log.mcap")

    def flies() -> bool:
        assert run.poll() is None
        with suppress(BlockingIOError):
            os.read(leader, 100_000)  # or the terminal would be full
        return log.exists() and log.stat().st_size > 20_000

    os.set_blocking(leader, False)
    wait_for(flies)
    os.close(leader)  # the system says SIGHUP
    assert run.wait(60) == 130
    assert json.loads(Path("out/metrics.json").read_text())["completed"] is False
    assert Path("out/report.html").exists()


def test_what_hears_a_signal_twice_is_told_once(start):
    """A terminal tells both processes; the one that looks on does not hand it on then."""
    process = start(*words(law("open('there', 'w').close(); time.sleep(0.05)"), "duration_s=4000"))
    wait_for(Path("there").exists)
    child = psutil.Process(process.pid).children()
    flying = [one for one in child if "mcap_writer" not in " ".join(one.cmdline())]
    assert len(flying) == 1
    flying[0].send_signal(signal.SIGINT)
    process.send_signal(signal.SIGINT)
    said, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert "interrupted at" in said


def test_a_flight_ends_with_the_process_that_looks_after_it(start):
    process = start("run", "hold", "duration_s=4000", "--speed", "1", "--out", "out")
    wait_for(Path("out/log.mcap").exists)
    child = psutil.Process(process.pid).children()
    process.kill()
    process.wait()
    wait_for(lambda: not any(one.is_running() and one.status() != "zombie" for one in child))
