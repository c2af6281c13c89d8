"""`testbed stop`: bring whatever flies to a stop, from anywhere, knowing nothing.

Vehicles brake, and at rest shut their air off; said again, they shut valves and air at once.

It needs no experiment and loads neither numpy nor anything else that takes its time. A host leaves
a note on its machine that says where it listens, and with which keys: whoever may read the note
needs none of his own. On another machine an operator's key folder says where the host is; it is
looked for in one place, so that nothing has to be typed in a hurry.
"""

import json
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from testbed.files import write_atomic

OK, FAILED = 0, 1
WAIT_S = 0.0  # for a host that is not there
LAST_RESORT = "what still moves: the main valve and the cord need neither keys nor network\n"


class Flight(NamedTuple):
    """Somewhere to say stop."""

    endpoint: str
    lab: str
    keys: str = ""  # folder; none: a flight on this machine


def _notes() -> Path:
    base = os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()
    return Path(base) / f"airbearing-testbed-{os.getuid()}"


def own_keys() -> Path:
    """Where an operator's keys are looked for."""
    return Path.home() / ".airbearing-testbed"


@contextmanager
def noted(endpoint: str, lab: str, keys: str = "") -> Iterator[None]:
    """Leave a note meanwhile of where this host listens."""
    folder = _notes()
    note = folder / f"{os.getpid()}.json"
    with suppress(OSError):
        folder.mkdir(mode=0o700, exist_ok=True)
        words = [endpoint, lab, str(Path(keys).absolute()) if keys else ""]
        write_atomic(note, json.dumps(words).encode())
    try:
        yield
    finally:
        note.unlink(missing_ok=True)


def _alive(note: Path) -> bool:
    try:
        os.kill(int(note.stem), 0)
    except (ValueError, OverflowError, ProcessLookupError):
        note.unlink(missing_ok=True)  # of a host that was killed
        return False
    except PermissionError:
        pass
    return True


def _known() -> list[Flight]:
    """Every flight on this machine."""
    found = []
    for note in sorted(_notes().glob("*.json")):
        with suppress(OSError, ValueError, TypeError, RecursionError):
            if _alive(note):
                found.append(Flight(*map(str, json.loads(note.read_text()))))
    return found


def _of(keys: Path, connect: str | None) -> Flight:
    """Where the owner of a key folder is to say stop."""
    from testbed.net.credentials import read_badge

    badge = read_badge(keys)
    if badge.ending:
        sys.stderr.write(f"{badge.ending}\n")
    return Flight(connect or badge.endpoint, badge.lab, str(keys))


def _flights(connect: str | None, lab: str, keys: Path | None) -> Iterator[Flight]:
    """Where to say stop; those on this machine first, whatever is wrong with the keys."""
    if keys is None and connect and not connect.startswith(("tls/", "quic/")):
        yield Flight(connect, lab)
    elif keys is None and not connect:
        yield from _known()
        if own_keys().exists():
            yield _of(own_keys(), None)
    else:
        yield _of(keys or own_keys(), connect)


def stop_everything(connect: str | None, lab: str, keys: Path | None = None) -> int:
    """Say stop to every host there is; the exit code.

    Args:
        connect: where a host listens; None: on this machine, and where an operator's keys say.
        lab: first part of all keys, without keys.
        keys: key folder of an operator; None: none is needed, or it is in its place.
    """
    from testbed.net.credentials import BadgeError

    tried = stopped = 0
    try:
        for flight in _flights(connect, lab, keys):
            tried += 1
            stopped += _stop(flight)
    except BadgeError as error:
        tried += 1
        sys.stderr.write(f"{error}\n")
    if not tried:
        sys.stderr.write(
            "nothing flies on this machine; elsewhere: testbed stop --connect, or --keys\n"
        )
    elif stopped < tried:
        sys.stderr.write(LAST_RESORT)
    return OK if 0 < tried == stopped else FAILED


def _stop(flight: Flight) -> bool:
    """Say stop to a host; whether anybody has."""
    from testbed.net.keys import Keys
    from testbed.net.session import NetworkError, ask_all, dial

    endpoint, lab, keys = flight
    try:
        with dial(endpoint, WAIT_S, Path(keys) if keys else None) as session:
            key = Keys(lab).stop
            session.put(key, b"stop")
            heard = ask_all(session, key)
    except NetworkError as error:
        sys.stderr.write(f"not stopped: {error}\n")
        return False
    who = "1 vehicle stops" if heard == 1 else f"{heard} vehicles stop"
    sys.stdout.write(f"{endpoint}: {who}; once more shuts valves and air at once\n")
    return heard > 0
