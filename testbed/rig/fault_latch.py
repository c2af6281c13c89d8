"""The fault of the last run, kept in a file: the next run needs a reset by the operator.

The supervisor ends with the process of its run; the latch outlives it. It is set before valves may
open and removed when the run ends in order, so it also holds after the host was killed. There is
one latch per rig and lab, on the host.
"""

import json
import os
from contextlib import suppress
from pathlib import Path

from testbed.files import write_atomic

KILLED = "the run did not end in order: its host was killed or lost power"


def state_folder() -> Path:
    """Folder for state that outlives a login."""
    base = os.environ.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
    return Path(base) / "airbearing-testbed"


class FaultLatch:
    """The fault latch of a rig and lab.

    Args:
        rig: bench or table.
        lab: first part of its network keys.
        run: name of the current run, for messages.
    """

    def __init__(self, rig: str, lab: str, run: str) -> None:
        self.path = state_folder() / f"{rig}-{lab}.json"
        self._run = run

    @property
    def fault(self) -> str | None:
        """Fault of the previous run; None: it ended in order."""
        try:
            run, fault = json.loads(self.path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            return f"the fault latch of the previous run cannot be read ({error})"
        return f"{run}: {fault}"

    def set(self, fault: str = KILLED) -> None:
        """Latch a fault.

        Raises:
            OSError: the file cannot be written.
        """
        self.path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(self.path, json.dumps([self._run, fault]).encode())

    def clear(self) -> None:
        """Remove the latch: the run has ended in order."""
        with suppress(FileNotFoundError):
            self.path.unlink()
