"""The fault of the last run, kept in a file: the next run needs a reset by the operator.

The supervisor ends with the process of its run; the latch outlives it. It is set before valves may
open and removed when the run ends in order, so it also holds after the host was killed. There is
one latch per rig and lab, on the host.
"""

import os
from contextlib import suppress
from pathlib import Path

import msgspec
from msgspec.structs import replace

from testbed.core.codes import FaultId, FaultReport
from testbed.files import write_atomic

KILLED = FaultReport(
    FaultId.PROCESS_ENDED, "the run did not end in order: its host was killed or lost power"
)


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
    def fault(self) -> FaultReport | None:
        """Fault of the previous run; None: it ended in order."""
        try:
            return msgspec.json.decode(self.path.read_bytes(), type=FaultReport)
        except FileNotFoundError:
            return None
        except (OSError, msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            text = f"the fault latch of the previous run cannot be read ({error})"
            return FaultReport(FaultId.PROCESS_ENDED, text)

    def set(self, fault: FaultReport = KILLED) -> None:
        """Latch a fault.

        Raises:
            OSError: the file cannot be written.
        """
        self.path.parent.mkdir(parents=True, exist_ok=True)
        kept = replace(fault, notes=(*fault.notes, f"in {self._run}"))
        write_atomic(self.path, msgspec.json.encode(kept))

    def clear(self) -> None:
        """Remove the latch: the run has ended in order."""
        with suppress(FileNotFoundError):
            self.path.unlink()
