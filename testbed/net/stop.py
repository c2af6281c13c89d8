"""`testbed stop`: shut every valve, from anywhere, knowing nothing.

It needs no experiment and loads neither numpy nor anything else that takes its time. A flight
leaves a note on its machine: a host, where it listens and with which keys, so that a reader of the
note needs none of his own; a flight on the twin, which process it is. The place where a host
listens by default is tried without a note, too. On another machine an operator's key folder says
where the host is; it is looked for in one place, so that nothing has to be typed in a hurry.

What was asked to stop and did not answer is named; the exit code is 0 only if all have answered.
"""

import json
import os
import signal
import socket
import stat
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from time import monotonic
from typing import NamedTuple

from testbed.core.error import TestbedError
from testbed.files import write_atomic

OK, FAILED = 0, 1
WAIT_S = 0.0  # for a host that is not there
OPEN_S = 1.0  # for one that is there and says nothing
ANSWER_S = 0.5  # for vehicles
END_S = 2.0  # for a flight on the twin to end
LOOK_S = 0.02
DEFAULT = "tcp/127.0.0.1:7450"  # where a host listens that was told nothing else
LAST_RESORT = "what still moves: the main valve and the cord need neither keys nor network\n"
BY_THEMSELVES = "its vehicles brake and shut by themselves when they have not heard it for a second"


class Flight(NamedTuple):
    """Somewhere to say stop."""

    endpoint: str  # empty: on the twin
    lab: str = "lab"
    keys: str = ""  # folder; none: a flight on this machine
    vehicles: Sequence[str] = ()  # none: the host is asked
    name: str = ""
    pid: int = 0  # 0: not known
    started: str = ""  # the process, in the system's words: numbers of processes come again


class NoteError(TestbedError):
    """The folder of the notes is not to be trusted."""


def _bases(uid: int) -> list[Path]:
    """Where a user's notes may be; ssh, sudo and cron do not say it."""
    said = os.environ.get("XDG_RUNTIME_DIR")
    if said and uid == os.getuid():
        return [Path(said)]
    login = Path(f"/run/user/{uid}")
    return [*([login] if login.is_dir() else []), Path(tempfile.gettempdir())]


def _folders() -> list[tuple[Path, int]]:
    """Folders of notes and whose they must be; under sudo also those of the user who called it."""
    users = [os.getuid()]
    if users == [0] and os.environ.get("SUDO_UID", "").isdecimal():
        users.append(int(os.environ["SUDO_UID"]))
    return [(base / f"airbearing-testbed-{uid}", uid) for uid in users for base in _bases(uid)]


def _notes() -> Path:
    """Where this process would leave a note."""
    return _folders()[0][0]


def _check(folder: Path, uid: int) -> None:
    """Raise a NoteError if others could have written these notes."""
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode):
        raise NoteError(f"{folder} is not a folder; remove it")
    if found.st_uid != uid:
        raise NoteError(
            f"{folder} belongs to user {found.st_uid}, expected {uid}: somebody else has made it;"
            " have it removed"
        )
    if found.st_mode & 0o022:
        raise NoteError(
            f"{folder} can be written by others (mode {found.st_mode & 0o777:o}, expected 700):"
            f" chmod 700 {folder}"
        )


def own_keys() -> Path:
    """Where an operator's keys are looked for."""
    return Path.home() / ".airbearing-testbed"


def _complain(text: str) -> None:
    sys.stderr.write(f"{text}\n")


@contextmanager
def noted(
    endpoint: str, lab: str, keys: str = "", vehicles: Sequence[str] = (), name: str = "",
    pid: int = 0, say: Callable[[str], None] = _complain,
) -> Iterator[None]:  # fmt: skip
    """Leave a note meanwhile of a flight.

    Args:
        endpoint: where its host listens; empty: it is flown on the twin.
        lab, keys: of that host.
        vehicles: that fly.
        name: of the experiment.
        pid: of the process that ends the flight; 0: this one.
        say: is told if there can be no note; the flight goes on.
    """
    pid = pid or os.getpid()
    keys = str(Path(keys).absolute()) if keys else ""
    flight = Flight(endpoint, lab, keys, list(vehicles), name, pid, _started(pid))
    try:
        note = _leave(json.dumps(flight._asdict()).encode())
    except (OSError, NoteError) as error:
        note = None
        place = f" --connect {endpoint}" if endpoint else ": not on the twin, use Ctrl-C"
        say(f"warning: no note for `testbed stop`: {error}; it needs{place}")
    try:
        yield
    finally:
        if note is not None:
            with suppress(OSError):
                note.unlink()


def _leave(text: bytes) -> Path:
    """The note, in the first folder that takes it."""
    trouble: Exception = NoteError("there is no folder for it")
    for folder, uid in _folders()[: len(_bases(os.getuid()))]:
        try:
            folder.mkdir(mode=0o700, exist_ok=True)
            _check(folder, uid)
            note = folder / f"{os.getpid()}.json"
            write_atomic(note, text)
        except (OSError, NoteError) as error:
            trouble = error
        else:
            return note
    raise trouble


def _started(pid: int) -> str:
    """When a process was started, in the system's words; empty: it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return ""
    return "" if fields[0] == "Z" else fields[19]


def _runs(flight: Flight) -> bool:
    """Whether the process of a note still does."""
    return not flight.pid or _started(flight.pid) == flight.started != ""


def _known() -> Iterator[tuple[Path, Flight]]:
    """Every note on this machine."""
    for folder, uid in _folders():
        try:
            _check(folder, uid)
        except FileNotFoundError:
            continue
        except (OSError, NoteError) as error:
            _complain(f"notes of flights are not read: {error}")
            continue
        for note in sorted(folder.glob("*.json")):
            with suppress(OSError, ValueError, TypeError, RecursionError):
                flight = Flight(**json.loads(note.read_text()))
                if [type(value) for value in flight] == [str, str, str, list, str, int, str]:
                    yield note, flight


def _of(keys: Path, connect: str | None) -> Flight:
    """Where the owner of a key folder is to say stop."""
    from testbed.net.credentials import read_badge

    badge = read_badge(keys)
    if badge.ending:
        _complain(badge.ending)
    return Flight(connect or badge.endpoint, badge.lab, str(keys))


def stop_everything(connect: str | None, lab: str, keys: Path | None = None) -> int:
    """Say stop to every flight there is; the exit code.

    Args:
        connect: where a host listens; None: on this machine, and where an operator's keys say.
        lab: first part of all keys, without keys.
        keys: key folder of an operator; None: none is needed, or it is in its place.
    """
    from testbed.net.credentials import BadgeError

    stopped: list[bool] = []
    try:
        if keys is None and connect and not connect.startswith(("tls/", "quic/")):
            stopped.append(_stop_wires(Flight(connect, lab)))
        elif keys is None and not connect:
            stopped += _stop_here()
            if own_keys().exists():
                stopped.append(_stop_wires(_of(own_keys(), None)))
        else:
            stopped.append(_stop_wires(_of(keys or own_keys(), connect)))
    except BadgeError as error:
        stopped.append(False)
        _complain(str(error))
    if not stopped:
        _complain("nothing flies on this machine; elsewhere: testbed stop --connect, or --keys")
    elif not all(stopped):
        sys.stderr.write(LAST_RESORT)
    return OK if stopped and all(stopped) else FAILED


def _stop_here() -> Iterator[bool]:
    """Every flight on this machine; where there is no note, a host at the usual place."""
    tried = set()
    for note, flight in list(_known()):
        tried.add(flight.endpoint)
        if not _runs(flight):
            note.unlink(missing_ok=True)
            if flight.endpoint:
                words = f"the host, process {flight.pid}, was killed"
                _complain(f"{flight.endpoint}: {words}; {BY_THEMSELVES}")
                yield False
        elif flight.endpoint:
            yield _stop_wires(flight)
        else:
            yield _stop_twin(note, flight)
    if DEFAULT not in tried and _listens(DEFAULT):
        yield _stop_wires(Flight(DEFAULT))


def _listens(endpoint: str) -> bool:
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    with suppress(OSError), socket.create_connection((host, int(port)), OPEN_S):
        return True
    return False


def _stop_twin(note: Path, flight: Flight) -> bool:
    """Ask the process to end the flight; whether it has."""
    try:
        if Path(f"/proc/{flight.pid}").stat().st_uid != note.stat().st_uid:
            raise PermissionError("its process belongs to another user")
        os.kill(flight.pid, signal.SIGTERM)
    except FileNotFoundError:
        pass  # it has just ended
    except OSError as error:
        _complain(f"{flight.name} on the twin, process {flight.pid}: not asked: {error}")
        return False
    end = monotonic() + END_S
    while over := note.exists() and _runs(flight):
        if monotonic() > end:
            break
        threading.Event().wait(LOOK_S)
    words = "did not answer" if over else "ended"
    sys.stdout.write(f"{flight.name} on the twin, process {flight.pid}: {words}\n")
    return not over


def _stop_wires(flight: Flight) -> bool:
    """Say stop to a host and its vehicles; whether all of them have answered."""
    from testbed.net.keys import Keys
    from testbed.net.session import NetworkError, answers, dial

    keys = Keys(flight.lab)
    folder = Path(flight.keys) if flight.keys else None
    try:
        with dial(flight.endpoint, WAIT_S, folder, open_s=OPEN_S) as session:
            session.put(keys.stop, b"stop")
            shut = {data.decode(errors="replace") for data in answers(session, keys.stop, ANSWER_S)}
            names = flight.vehicles or _vehicles(answers(session, keys.experiment, ANSWER_S))
    except NetworkError as error:
        _complain(f"{flight.endpoint}: not stopped: {error}")
        if flight.pid:
            _complain(f"the host, process {flight.pid}, did not answer; {BY_THEMSELVES}")
        return False
    sys.stdout.write(f"{flight.endpoint}\n")
    for name in sorted({*names, *shut}):
        sys.stdout.write(f"  {name}: {'stops' if name in shut else 'did not answer'}\n")
    if shut:
        sys.stdout.write("  once more shuts valves and air at once\n")
    if not shut and not names:
        sys.stdout.write("  no vehicle has answered\n")
    return bool(shut) and shut >= set(names)


def _vehicles(experiments: Sequence[bytes]) -> list[str]:
    """Who flies, as the host says; nothing if it does not say it."""
    with suppress(ValueError, KeyError, TypeError, IndexError, RecursionError):
        return [str(name) for name in json.loads(experiments[0])["vehicles"]]
    return []
