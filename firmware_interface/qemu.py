"""The board's image on QEMU's STM32F405, on the wall clock: a smoke test of start and interrupts.

QEMU models neither GPIO nor TIM2's alarm nor the reset flags, so this image uses SysTick for time,
in milliseconds, and only the serial line works. The process is the child of a shell that waits for
the end of its input, so that it cannot outlive the process that started it.
"""

import contextlib
import re
import shutil
import subprocess

from firmware_interface.compiler import image
from firmware_interface.messages import Config
from firmware_interface.serial_board import BoardError, SerialBoard

QEMU = "qemu-system-arm"
GUARD = '"$@" </dev/null & child=$!; read -r _; kill -9 $child; wait $child'
ANNOUNCED = re.compile(r"redirected to (/dev/\S+)")


def emulator() -> str:
    """Path of QEMU.

    Raises:
        BoardError: QEMU is not installed.
    """
    if found := shutil.which(QEMU):
        return found
    raise BoardError(
        f"{QEMU} not found; on Debian `apt install --no-install-recommends {QEMU}`, or choose"
        " another board"
    )


def qemu_command(config: Config) -> list[str]:
    """The command line of QEMU."""
    return [
        *("sh", "-c", GUARD, "guard"),
        *(emulator(), "-M", "netduinoplus2", "-kernel", str(image(config, "systick"))),
        *("-display", "none", "-monitor", "none", "-serial", "pty"),
    ]


def terminal_of(output: str) -> str:
    """The terminal announced by the first line of QEMU's output.

    Raises:
        BoardError: the line names no terminal.
    """
    if found := ANNOUNCED.search(output):
        return found[1]
    raise BoardError(f"{QEMU} said {output!r}, expected the name of its terminal")


class QemuBoard(SerialBoard):
    """A `Board` on the wall clock.

    Args:
        config: limits, see `limits.limits_of`.
    """

    def __init__(self, config: Config) -> None:
        with contextlib.ExitStack() as stack:
            self._process = subprocess.Popen(
                qemu_command(config),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                start_new_session=True,
            )
            stack.callback(self._stop)
            super().__init__(self._terminal())
            self._rest = stack.pop_all()

    def _terminal(self) -> str:
        assert self._process.stdout is not None
        return terminal_of(self._process.stdout.readline())

    def _stop(self) -> None:
        """End QEMU through its guard, because QEMU ignores SIGTERM while its line is full."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()

    def close(self) -> None:
        """End the process and release all resources."""
        super().close()
        self._rest.close()
