"""The fault of a run, kept for the next one: nobody flies on after a fault without having looked.

A run on wires has a process of its own, and so has its supervisor; the latch is what outlives them.
It is set when valves may open and taken away when the run has come to an orderly end, so that it
holds also after a host that was killed. It is kept per rig and lab, on the host.
"""

import json
import os
from contextlib import suppress
from pathlib import Path

from testbed.files import write_atomic

KILLED = "the run did not come to an orderly end: its host was killed, or lost power"


def state_folder() -> Path:
    """Where programs keep what must outlive a login."""
    base = os.environ.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
    return Path(base) / "airbearing-testbed"


class FaultLatch:
    """One lab's.

    Args:
        rig: bench or table.
        lab: first part of its keys.
        run: what is flown now, for the words.
    """

    def __init__(self, rig: str, lab: str, run: str) -> None:
        self.path = state_folder() / f"{rig}-{lab}.json"
        self._run = run

    @property
    def fault(self) -> str | None:
        """How the run before ended, in words; None: in order."""
        try:
            run, fault = json.loads(self.path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            return f"what is left of the run before cannot be read ({error})"
        return f"{run}: {fault}"

    def set(self, fault: str = KILLED) -> None:
        """Latch.

        Raises:
            OSError: it cannot be kept.
        """
        self.path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(self.path, json.dumps([self._run, fault]).encode())

    def clear(self) -> None:
        """The run has ended in order."""
        with suppress(FileNotFoundError):
            self.path.unlink()
