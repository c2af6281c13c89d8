"""Notes that flights leave on their machine, so that `testbed stop` finds them.

The note of a host has its endpoint and its key folder, so the reader needs no keys of their own.
The note of a flight on the twin, and of a run that has no host yet, has its process id. No slow
modules such as numpy are imported.
"""

import json
import os
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from testbed.core.error import TestbedError
from testbed.files import write_atomic


class StoppableFlight(NamedTuple):
    """A flight that can be stopped."""

    endpoint: str  # of its host; empty: a flight on the twin, or a run that starts
    lab: str = "lab"
    keys: str = ""  # key folder; empty: no keys
    vehicles: Sequence[str] = ()  # empty: ask the host
    name: str = ""
    pid: int = 0  # 0: not known
    started: str = ""  # start time of the process in /proc: process ids are reused
    folder: str = ""  # run folder; empty: not known
    rig: str = "twin"  # without an endpoint
    ends_s: float = 0.0  # time to end after it has heard a stop; 0: not known [s]


_written: Path | None = None  # the newest note of this process
KINDS = [str, str, str, list, str, int, str, str, str, float]


class NoteError(TestbedError):
    """The folder of the notes cannot be trusted."""


def _bases(uid: int) -> list[Path]:
    """Folders that may hold a user's notes; ssh, sudo and cron do not set XDG_RUNTIME_DIR."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime and uid == os.getuid():
        return [Path(runtime)]
    login = Path(f"/run/user/{uid}")
    return [*([login] if login.is_dir() else []), Path(tempfile.gettempdir())]


def _folders() -> list[tuple[Path, int]]:
    """Folders of notes and their expected owners; under sudo also those of the calling user."""
    users = [os.getuid()]
    if users == [0] and os.environ.get("SUDO_UID", "").isdecimal():
        users.append(int(os.environ["SUDO_UID"]))
    return [(base / f"airbearing-testbed-{uid}", uid) for uid in users for base in _bases(uid)]


def _check(folder: Path, uid: int) -> None:
    """Raise a NoteError if other users could have written these notes."""
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode):
        raise NoteError(f"{folder} is not a folder; remove it")
    if found.st_uid != uid:
        raise NoteError(
            f"{folder} belongs to user {found.st_uid}, expected {uid}: another user made it;"
            " have it removed"
        )
    if found.st_mode & 0o022:
        raise NoteError(
            f"{folder} can be written by others (mode {found.st_mode & 0o777:o}, expected 700):"
            f" chmod 700 {folder}"
        )


def complain(text: str) -> None:
    """Print a line on stderr."""
    sys.stderr.write(f"{text}\n")


@contextmanager
def noted(
    endpoint: str, lab: str, keys: str = "", vehicles: Sequence[str] = (), name: str = "",
    pid: int = 0, warn: Callable[[str], None] = complain, folder: Path | None = None,
    rig: str = "twin", ends_s: float = 0.0,
) -> Iterator[None]:  # fmt: skip
    """Keep a note of a flight while the context is open; a process has one, the newest.

    Args:
        endpoint: where its host listens; empty: it is flown on the twin, or a run that starts.
        lab, keys: of that host.
        vehicles: the flight's vehicles.
        name: of the experiment.
        pid: process that ends the flight; 0: this one.
        warn: called with a warning if the note cannot be written; the flight goes on.
        folder: run folder, by which an operator's page finds the flight.
        rig: of a note without an endpoint.
        ends_s: longest time that it takes to end after it has heard a stop; 0: not known [s].
    """
    pid = pid or os.getpid()
    keys = str(Path(keys).absolute()) if keys else ""
    where = "" if folder is None else str(folder.absolute())
    flight = StoppableFlight(
        endpoint, lab, keys, list(vehicles), name, pid, _started(pid), where, rig, ends_s
    )
    try:
        text = json.dumps(flight._asdict()).encode()
        note = _in_first_folder(lambda note: _write(note, text))
    except OSError as error:
        note = None
        place = f" --connect {endpoint}" if endpoint else ": not on the twin, use Ctrl-C"
        warn(f"warning: no note for `testbed stop`: {error}; it needs{place}")
    try:
        yield
    finally:
        if note is not None:
            with suppress(OSError):
                remove(note)


def _write(note: Path, text: bytes) -> None:
    global _written
    if _written is None:  # what is there is of a killed process with the same id
        heard_stop(note).unlink(missing_ok=True)
    write_atomic(note, text)
    _written = note


def withdraw(pid: int) -> None:
    """Remove the note of a process that was killed before it could."""
    for folder, _ in _folders()[: len(_bases(os.getuid()))]:
        with suppress(OSError):
            remove(folder / f"{pid}.json")


def remove(note: Path) -> None:
    """Remove a note, and that its process has heard a stop."""
    note.unlink(missing_ok=True)
    heard_stop(note).unlink(missing_ok=True)


def heard_stop(note: Path) -> Path:
    """An empty file; it exists when the process of a note has heard a stop."""
    return note.with_suffix(".heard")


def tell_heard() -> None:
    """Tell `testbed stop` that this process has heard it."""
    with suppress(OSError):
        if _written is not None and _written.exists():
            heard_stop(_written).touch()


def request_socket(note: Path) -> Path:
    """Socket of `operator_requests.py`; it exists while the flight receives requests."""
    return note.with_suffix(".sock")


def own_note() -> Path:
    """Where this process would leave its note.

    Raises:
        OSError: there is no place for it.
    """
    return _in_first_folder(lambda note: None)


def _in_first_folder(write: Callable[[Path], None]) -> Path:
    """This process's note in the first folder where `write` succeeds."""
    trouble: Exception = NoteError("no folder for it")
    for folder, uid in _folders()[: len(_bases(os.getuid()))]:
        note = folder / f"{os.getpid()}.json"
        try:
            folder.mkdir(mode=0o700, exist_ok=True)
            _check(folder, uid)
            write(note)
        except (OSError, NoteError) as error:
            trouble = error
        else:
            return note
    raise OSError(str(trouble))


def _started(pid: int) -> str:
    """Start time of a process as in /proc; empty: it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return ""
    return "" if fields[0] == "Z" else fields[19]


def runs(flight: StoppableFlight) -> bool:
    """Whether the process of a note still runs."""
    return not flight.pid or _started(flight.pid) == flight.started != ""


def known_flights() -> Iterator[tuple[Path, StoppableFlight]]:
    """Every note on this machine."""
    for folder, uid in _folders():
        try:
            _check(folder, uid)
        except FileNotFoundError:
            continue
        except (OSError, NoteError) as error:
            complain(f"notes of flights are not read: {error}")
            continue
        for note in sorted(folder.glob("*.json")):
            with suppress(OSError, ValueError, TypeError, RecursionError):
                flight = StoppableFlight(**json.loads(note.read_text()))
                if [type(value) for value in flight] == KINDS:
                    yield note, flight
