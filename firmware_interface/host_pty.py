"""The firmware as a process on a pseudo-terminal, in real time, with the interface of a board."""

import contextlib
import subprocess
import tempfile
from pathlib import Path

from firmware_interface.compiler import firmware_id, host_program
from firmware_interface.messages import Config, ResetCause
from firmware_interface.reports import Reports
from firmware_interface.serial_board import BoardError, SerialBoard

GRACE_S = 5.0


def bury(process: subprocess.Popen, grace_s: float) -> None:
    """Wait for a process that was asked to end, kill it if it does not, close its pipes."""
    try:
        process.wait(grace_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with contextlib.suppress(OSError):
                pipe.close()


class HostPtyBoard(SerialBoard):
    """A `Board` on the wall clock. Its process ends on `close`, or with this process.

    Args:
        config: limits, see `limits.limits_of`.
        boot_nonce: of the first boot; every power cycle adds one.
        link: path of a symbolic link to the terminal, for other programs; by default in a folder
            that `close` removes.
    """

    def __init__(self, config: Config, boot_nonce: int = 1, link: Path | None = None) -> None:
        with contextlib.ExitStack() as stack:
            if link is None:
                folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="abt-board-"))
                link = Path(folder) / "board"
            self._process = subprocess.Popen(
                [host_program(), config.pack().hex(), str(firmware_id()), str(boot_nonce), link],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                bufsize=1,
                start_new_session=True,  # Ctrl-C is for the operator's program, which disarms
            )
            stack.callback(self._stop)
            self._confirm()
            super().__init__(str(link))
            self._rest = stack.pop_all()

    @property
    def pid(self) -> int:
        """Process id of the firmware."""
        return self._process.pid

    def _confirm(self) -> None:
        assert self._process.stdout is not None
        answer = self._process.stdout.readline()
        if answer != "ok\n":
            raise BoardError(f"the board's process answered {answer!r}, expected 'ok'; see above")

    def _order(self, text: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(text + "\n")
        self._confirm()

    def sense(self, supply_mv: int, supply_pa: int) -> None:
        """Set the readings of the board's sensors from now on."""
        self._order(f"sense {supply_mv} {supply_pa}")

    def power_cycle(self, cause: ResetCause) -> None:
        """Reboot for this cause; time restarts at 0, sensor readings are kept."""
        self._order("down")
        with self._changed:
            self._waiting.clear()
            self._received.clear()
            self._reports = Reports()
        self._order(f"up {cause:d}")

    def _stop(self) -> None:
        self._process.terminate()
        bury(self._process, GRACE_S)

    def close(self) -> None:
        """End the process and release all resources."""
        super().close()
        self._rest.close()
