"""`testbed stop`: where it looks, whom it believes, and who has answered."""

import json
import os
import signal
import socket
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from ports import free_port
from testbed.cli import run as verb
from testbed.core.lab import Network
from testbed.net import flight_note
from testbed.net import stop as stopping
from testbed.net.flight_note import StoppableFlight, known_flights, noted
from testbed.net.keys import Keys
from testbed.net.session import answer_to, listen
from testbed.net.stop import FAILED, OK, stop_everything
from testbed.run.folder import FolderError

KEYS = Keys("lab")
WAITS = "import sys; print(flush=True); sys.stdin.read()"
BRAKES = "import signal, time; signal.signal(signal.SIGTERM, lambda *_: time.sleep({}) or exit());"
DEAF = f"import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); {WAITS}"

ONCE_MORE = "  stop again to shut valves and air at once"


@pytest.fixture
def here(tmp_path, monkeypatch):
    """The folder of notes of a machine on which nothing flies."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.delenv("SUDO_UID", raising=False)
    monkeypatch.setattr(stopping, "own_keys", lambda: tmp_path / "home")
    monkeypatch.setattr(stopping, "DEFAULT", f"tcp/127.0.0.1:{free_port()}")
    return tmp_path / f"airbearing-testbed-{os.getuid()}"


@pytest.fixture
def process():
    """Start a program; it waits until it is ended."""
    started = []

    def start(program: str) -> int:
        one = subprocess.Popen(
            [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        started.append(one)
        one.stdout.readline()
        return one.pid

    yield start
    for one in started:
        one.kill()
        one.communicate()


def host_at(endpoint, shut, flown, ended=None):
    """A host's session with vehicles that shut or had ended, and an experiment with all of them."""
    session = listen(endpoint)
    kept = [answer_to(session, KEYS.stop, lambda _, n=name: n.encode()) for name in shut]
    text = json.dumps({"vehicles": {name: {} for name in flown}}).encode()
    kept.append(answer_to(session, KEYS.experiment, lambda _: text))
    if ended is not None:
        kept.append(answer_to(session, KEYS.ended, lambda _: ended))
    return session, kept


# Notes


def test_a_note_is_there_for_as_long_as_the_flight(here):
    with noted("tcp/127.0.0.1:1", "lab"):
        assert [path.name for path in here.iterdir()] == [f"{os.getpid()}.json"]
        assert stat.S_IMODE(here.stat().st_mode) == 0o700
    assert list(here.iterdir()) == []


def refused(here, capsys) -> str:
    """Neither written nor read: what is said of both."""
    said = []
    with noted("tcp/127.0.0.1:1", "lab", warn=said.append):
        pass
    assert len(said) == 1
    assert said[0].startswith("warning: no note for `testbed stop`: ")
    assert "--connect tcp/127.0.0.1:1" in said[0]
    assert stop_everything(None, "lab") == FAILED
    heard = capsys.readouterr().err
    assert "no flight on this machine" in heard
    return said[0] + heard


def test_a_folder_that_others_can_write_is_refused(here, capsys):
    here.mkdir()
    here.chmod(0o777)
    (here / "1.json").write_text("[]")
    assert refused(here, capsys).count("can be written by others (mode 777, expected 700)") == 2


def test_a_folder_of_another_user_is_refused(here, capsys, monkeypatch):
    here.mkdir(mode=0o700)
    folder = flight_note._folders()[0][0]
    monkeypatch.setattr(flight_note, "_folders", lambda: [(folder, os.getuid() + 1)])
    assert refused(here, capsys).count(f"belongs to user {os.getuid()}, expected") == 2


def test_a_link_is_no_folder(here, capsys, tmp_path):
    (tmp_path / "mine").mkdir(mode=0o700)
    here.symlink_to(tmp_path / "mine")
    assert refused(here, capsys).count("is not a folder") == 2


def test_a_note_that_cannot_be_written_is_said_and_the_flight_goes_on(here, monkeypatch):
    def full(path, data):
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(flight_note, "write_atomic", full)
    said, flown = [], False
    with noted("tcp/127.0.0.1:1", "lab", warn=said.append):
        flown = True
    assert flown
    assert "No space left on device" in said[0]


def test_notes_are_found_without_the_variable_of_the_login(tmp_path, monkeypatch):
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr(flight_note.tempfile, "tempdir", str(tmp_path))
    places = [folder for folder, _ in flight_note._folders()]
    assert tmp_path / f"airbearing-testbed-{os.getuid()}" in places


# Hosts


def test_the_default_place_is_that_of_a_host():
    assert Network().endpoint == stopping.DEFAULT


def test_without_a_note_the_default_place_is_tried(here, capsys):
    session, kept = host_at(stopping.DEFAULT, ["sat1", "sat2"], ["sat1", "sat2"])
    with session:
        assert stop_everything(None, "lab") == OK
        del kept
    lines = [stopping.DEFAULT, "  sat1: stops", "  sat2: stops"]
    assert capsys.readouterr().out.splitlines() == [*lines, ONCE_MORE]


def test_a_vehicle_that_does_not_answer_is_named(here, capsys):
    session, kept = host_at(stopping.DEFAULT, ["sat1"], ["sat1", "sat2"])
    with session:
        assert stop_everything(None, "lab") == FAILED
        del kept
    said = capsys.readouterr()
    lines = [stopping.DEFAULT, "  sat1: stops", "  sat2: did not answer"]
    assert said.out.splitlines() == [*lines, ONCE_MORE]
    assert "main valve" in said.err


@pytest.mark.parametrize(("air", "code"), [("off", OK), ("on", FAILED)])
def test_vehicles_that_had_ended_their_flight_need_no_stop(here, capsys, air, code):
    ended = json.dumps({"sat2": air}).encode()
    session, kept = host_at(stopping.DEFAULT, ["sat1"], ["sat1", "sat2"], ended)
    with session:
        assert stop_everything(None, "lab") == code
        del kept
    said = capsys.readouterr()
    lines = [stopping.DEFAULT, "  sat1: stops", f"  sat2: had ended, bearing air {air}"]
    assert said.out.splitlines() == [*lines, ONCE_MORE]
    assert ("main valve" in said.err) == (code == FAILED)


@pytest.mark.parametrize("nonsense", [b"", b"[]", b"{", b"7"])
def test_what_a_host_says_of_ended_flights_may_be_nonsense(here, capsys, nonsense):
    session, kept = host_at(stopping.DEFAULT, ["sat1"], ["sat1", "sat2"], nonsense)
    with session:
        assert stop_everything(None, "lab") == FAILED
        del kept
    assert "  sat2: did not answer" in capsys.readouterr().out


def test_a_busy_host_may_say_later_which_vehicles_have_ended(here, capsys):
    said = [b'{"sat2": "off"}', b"{}", b"{}"]
    session = listen(stopping.DEFAULT)
    kept = [
        answer_to(session, KEYS.experiment, lambda _: b'{"vehicles": {"sat2": {}}}'),
        answer_to(session, KEYS.ended, lambda _: said.pop()),
    ]
    with session:
        assert stop_everything(None, "lab") == OK
        del kept
    assert said == []
    assert "  sat2: had ended, bearing air off" in capsys.readouterr().out


def test_a_host_that_hangs_is_said(here, capsys):
    """The system accepts for a process that is stopped; nothing ever answers."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        endpoint = f"tcp/127.0.0.1:{server.getsockname()[1]}"
        with noted(endpoint, "lab", vehicles=["sat1"], name="hold"):
            assert stop_everything(None, "lab") == FAILED
    said = capsys.readouterr().err
    assert f"the host, process {os.getpid()}, did not answer" in said
    assert "vehicles without a host brake and shut by themselves" in said


def test_a_host_that_was_killed_is_said_once(here, capsys, process):
    pid = process(WAITS)
    with noted("tcp/127.0.0.1:1", "lab", name="hold", pid=pid):
        os.kill(pid, signal.SIGKILL)
        os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
        assert stop_everything(None, "lab") == FAILED
        assert f"process {pid}, was killed" in capsys.readouterr().err
        assert stop_everything(None, "lab") == FAILED
        assert "no flight on" in capsys.readouterr().err


def test_a_host_that_lives_is_stopped_before_those_that_were_killed(here, capsys, monkeypatch):
    session, kept = host_at(stopping.DEFAULT, ["sat1"], ["sat1"])
    killed = StoppableFlight("tcp/127.0.0.1:1", pid=1, started="never")
    lives = StoppableFlight(stopping.DEFAULT, vehicles=["sat1"])
    notes = [(here / str(k), one) for k, one in enumerate((killed, lives, killed))]
    monkeypatch.setattr(stopping, "known_flights", lambda: notes)
    monkeypatch.setattr(stopping, "runs", lambda flight: flight is lives)
    with session:
        assert list(stopping._stop_here([])) == [True, False, False]
        del kept
    assert capsys.readouterr().out == f"{stopping.DEFAULT}\n  sat1: stops\n{ONCE_MORE}\n"


def test_vehicles_of_a_killed_host_do_not_wait_for_the_default_address(here, monkeypatch):
    """To ask vehicles that may be nowhere takes the whole time for an answer."""
    killed = StoppableFlight("tcp/127.0.0.1:1", pid=1, started="never", vehicles=["sat1"])
    asked = []
    monkeypatch.setattr(stopping, "known_flights", lambda: [(here / "0", killed)])
    monkeypatch.setattr(
        stopping, "_stop_directly", lambda flight, stop: asked.append(flight.endpoint) or set()
    )
    assert list(stopping._stop_here([])) == [False]
    assert asked == [killed.endpoint, stopping.DEFAULT]


# Flights on the twin


def test_a_flight_on_the_twin_is_ended(here, capsys, process):
    pid = process(WAITS)
    with noted("", "", name="hold", pid=pid):
        assert stop_everything(None, "lab") == OK
    assert capsys.readouterr().out == f"hold on the twin, process {pid}: ended\n"


def test_a_flight_on_the_twin_that_does_not_end_is_said(here, capsys, process, monkeypatch):
    monkeypatch.setattr(stopping, "END_S", 0.1)
    pid = process(DEAF)
    with noted("", "", name="hold", pid=pid, ends_s=60.0):
        assert stop_everything(None, "lab") == FAILED
    assert f"hold on the twin, process {pid}: did not answer\n" in capsys.readouterr().out


@pytest.mark.parametrize(("s", "words"), [(0.5, "ended"), (60, "heard the stop and did not end")])
def test_a_flight_that_has_heard_may_brake(here, capsys, process, monkeypatch, s, words):
    """It is waited for as long as its brake may last, and no longer."""
    monkeypatch.setattr(stopping, "END_S", 0.1)
    pid = process(BRAKES.format(s) + WAITS)
    with noted("", "", name="hold", pid=pid, ends_s=2.0):
        flight_note.tell_heard()
        assert stop_everything(None, "lab") == (OK if words == "ended" else FAILED)
    said = f"hold on the twin, process {pid}: "
    assert capsys.readouterr().out == f"{said}stops within 2 s\n{said}{words}\n"
    assert list(here.iterdir()) == []


def test_all_flights_on_the_twin_are_asked_before_one_is_waited_for(
    here, process, capsys, monkeypatch
):
    monkeypatch.setattr(stopping, "END_S", 2.0)
    deaf, hears = (StoppableFlight("", name="hold", pid=process(one)) for one in (DEAF, WAITS))
    flights = [one._replace(started=flight_note._started(one.pid)) for one in (deaf, hears)]
    here.mkdir()
    (note := here / "note").touch()
    monkeypatch.setattr(stopping, "known_flights", lambda: [(note, one) for one in flights])
    assert stop_everything(None, "lab") == FAILED
    first, second = capsys.readouterr().out.splitlines()
    assert first == f"hold on the twin, process {flights[1].pid}: ended"  # not after the deaf one
    assert second == f"hold on the twin, process {flights[0].pid}: did not answer"


def test_hosts_are_stopped_before_a_flight_on_the_twin_is_waited_for(here, process, monkeypatch):
    """A brake on the twin may last a minute; the vehicles of another machine's host are real."""
    order, pid = [], process(WAITS)
    (keys := here.parent / "keys").mkdir()
    monkeypatch.setattr(stopping, "own_keys", lambda: keys)
    monkeypatch.setattr(stopping, "_of", lambda keys, connect: StoppableFlight("tcp/far:1"))
    monkeypatch.setattr(stopping, "_stop_wires", lambda flight: order.append("host") or True)
    monkeypatch.setattr(stopping, "_wait_for", lambda asked: [order.append(len(asked)) or True])
    with noted("", "", name="hold", pid=pid):
        assert stop_everything(None, "lab") == OK
    assert order == ["host", 1]


def test_a_killed_process_with_the_same_number_has_heard_nothing_of_this_stop(here, monkeypatch):
    monkeypatch.setattr(flight_note, "_written", None)
    here.mkdir(mode=0o700)
    (old := here / f"{os.getpid()}.heard").touch()
    with noted("", "", name="hold"):
        assert not old.exists()
        flight_note.tell_heard()
        with noted("", "", name="hold", ends_s=9.0):  # the flight that this run began
            assert old.exists()


def test_another_process_with_the_same_number_is_left_alone(here, process):
    pid = process(WAITS)
    with noted("", "", name="hold", pid=pid):
        note = next(here.iterdir())
        note.write_text(note.read_text().replace(flight_note._started(pid), "1"))
        assert stop_everything(None, "lab") == FAILED
    assert flight_note._started(pid)


def stopped_once(folder, words, ready):
    """A run of `hold` in this folder that `testbed stop` ends as soon as it is ready."""
    run = subprocess.Popen(
        [sys.executable, "-m", "testbed", "run", "hold", *words], cwd=folder, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).resolve().parents[2])},
    )  # fmt: skip
    try:
        while not ready():
            assert run.poll() is None, run.communicate()
            threading.Event().wait(0.05)
        assert stop_everything(None, "lab") == OK
        said, errors = run.communicate(timeout=60)
    finally:
        run.kill()
    return run, said, errors


def test_a_run_on_the_twin_is_stopped(here, tmp_path):
    log = tmp_path / "out" / "log.mcap"
    words = ["duration_s=4000", "--speed", "1", "--out", "out"]
    run, said, errors = stopped_once(
        tmp_path, words, lambda: log.exists() and log.stat().st_size > 20_000
    )
    assert run.returncode == 130, errors
    assert "interrupted at" in said
    assert json.loads((tmp_path / "out" / "metrics.json").read_text())["completed"] is False


def test_vehicles_that_answer_late_are_asked_again(monkeypatch, capsys):
    asked = []

    def directly(flight, stop, wait_s=0.3):
        asked.append((sorted(flight.vehicles), stop))
        return {"sat1"} if len(asked) == 1 else {"sat2"} if len(asked) == 3 else set()

    monkeypatch.setattr("testbed.net.stop._stop_directly", directly)
    session, kept = host_at(endpoint := f"tcp/127.0.0.1:{free_port()}", [], ["sat1", "sat2"])
    with session:
        assert stop_everything(endpoint, "lab") == OK
        del kept
    assert [names for names, _ in asked] == [[], ["sat2"], ["sat2"]]
    assert asked[0][1] == asked[1][1]  # the same stop: it counts once
    assert "sat2: stops" in capsys.readouterr().out


# Runs that start


READS_LONG = """\
import time
open("there", "w").close()
time.sleep(60)
"""


@pytest.mark.parametrize("rig", ["twin", "bench"])
def test_a_run_that_starts_is_stopped(here, tmp_path, capsys, rig):
    """It still reads its law; no flight follows, and nothing is left of it."""
    (tmp_path / "my_law.py").write_text(READS_LONG)
    words = ["controller={type='python',law='my_law.py:Mine'}", "--rig", rig, "--out", "out"]
    run, said, errors = stopped_once(tmp_path, words, (tmp_path / "there").exists)
    assert (run.returncode, said, errors) == (130, "", "")
    assert capsys.readouterr().out == f"hold on the {rig}, process {run.pid}: ended\n"
    assert not (tmp_path / "out").exists()
    assert list(here.iterdir()) == []


@pytest.mark.parametrize("rig", ["twin", "bench"])
def test_a_run_with_a_folder_has_a_note_that_names_it(here, tmp_path, monkeypatch, rig):
    """Its page looks for the flight by its folder; `testbed stop` waits for its brake."""
    notes, heard = [], []

    def seen(*args):
        notes.extend(flight for _, flight in known_flights())
        signal.raise_signal(signal.SIGTERM)
        heard.extend(here.glob("*.heard"))
        raise FolderError("seen")

    monkeypatch.setattr(verb, "write_config", seen)
    options = verb.RunOptions(rig, tmp_path / "out", speed=0.5)
    assert verb.run_experiment("hold", ["flight.ending.brake_s=8.0"], options) == 2
    assert [(one.rig, one.folder, one.endpoint) for one in notes] == [
        (rig, str(tmp_path / "out"), "")
    ]
    assert 8.0 / 0.5 < notes[0].ends_s < 11.0 / 0.5
    assert [one.stem for one in heard] == [str(os.getpid())]
    assert list(here.iterdir()) == []


def test_hosts_are_stopped_before_what_is_waited_for(here, monkeypatch):
    twin, host = StoppableFlight("", name="hold"), StoppableFlight("tcp/127.0.0.1:1")
    asked = []
    monkeypatch.setattr(stopping, "known_flights", lambda: [(here / "0", twin), (here / "1", host)])
    monkeypatch.setattr(stopping, "_stop_wires", lambda flight: asked.append(flight) or True)
    monkeypatch.setattr(stopping, "end_twin", lambda note, flight: asked.append(flight))
    monkeypatch.setattr(stopping, "_stop_directly", lambda *args: set())
    waited_for = []
    assert list(stopping._stop_here(waited_for)) == [True]
    assert asked == [host, twin]
    assert [one.flight for one in waited_for] == [twin]
