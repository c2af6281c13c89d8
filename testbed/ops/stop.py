"""`testbed stop`: shut every valve, from anywhere, knowing nothing.

It needs no experiment and loads neither numpy nor anything else that takes its time. A host leaves
a note on its machine that says where it listens; on another machine one has to say so oneself.
"""

import json
import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

OK, FAILED = 0, 1


def _notes() -> Path:
    base = os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()
    return Path(base) / f"airbearing-testbed-{os.getuid()}"


@contextmanager
def noted(endpoint: str, lab: str) -> Iterator[None]:
    """Leave a note meanwhile of where this host listens."""
    folder = _notes()
    note = folder / f"{os.getpid()}.json"
    with suppress(OSError):
        folder.mkdir(mode=0o700, exist_ok=True)
        note.write_text(json.dumps([endpoint, lab]))
    try:
        yield
    finally:
        note.unlink(missing_ok=True)


def _alive(note: Path) -> bool:
    try:
        os.kill(int(note.stem), 0)
    except (ValueError, ProcessLookupError):
        note.unlink(missing_ok=True)  # of a host that was killed
        return False
    except PermissionError:
        pass
    return True


def _known() -> list[tuple[str, str]]:
    found = []
    for note in sorted(_notes().glob("*.json")):
        with suppress(OSError, ValueError):
            if _alive(note):
                endpoint, lab = json.loads(note.read_text())
                found.append((str(endpoint), str(lab)))
    return found


def stop_everything(connect: str | None, lab: str) -> int:
    """Say stop to every host there is; the exit code."""
    flights = [(connect, lab)] if connect else _known()
    if not flights:
        sys.stderr.write("nothing flies on this machine; elsewhere: testbed stop --connect\n")
        return FAILED
    from testbed.ops.network.keys import Keys
    from testbed.ops.network.session import NetworkError, ask_all, dial

    code = OK
    for endpoint, name in flights:
        try:
            with dial(endpoint, 0.0) as session:
                key = Keys(name).stop
                session.put(key, b"stop")
                heard = ask_all(session, key)
            sys.stdout.write(f"{endpoint}: {heard} vehicles have closed their valves\n")
            if not heard:
                code = FAILED
        except NetworkError as error:
            sys.stderr.write(f"{error}\n")
            code = FAILED
    return code
