"""The board's image on QEMU's STM32F405, on the wall clock: a smoke test of start and interrupts.

QEMU models neither GPIO nor TIM2's alarm nor the reset flags, so this image keeps time by SysTick,
in milliseconds, and only the serial line leads anywhere. The process stands behind a shell that
waits for the end of its input, so that it cannot outlive whoever started it.
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
    """The program.

    Raises:
        BoardError: it is not installed.
    """
    if found := shutil.which(QEMU):
        return found
    raise BoardError(
        f"{QEMU} not found; on Debian `apt install --no-install-recommends {QEMU}`, or choose"
        " another board"
    )


class QemuBoard(SerialBoard):
    """A `Board` on the wall clock.

    Args:
        config: limits, see `limits.limits_of`.
    """

    def __init__(self, config: Config) -> None:
        command = [
            *(emulator(), "-M", "netduinoplus2", "-kernel", str(image(config, "systick"))),
            *("-display", "none", "-monitor", "none", "-serial", "pty"),
        ]
        with contextlib.ExitStack() as stack:
            self._process = subprocess.Popen(
                ["sh", "-c", GUARD, "guard", *command],
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
        said = self._process.stdout.readline()
        if found := ANNOUNCED.search(said):
            return found[1]
        raise BoardError(f"{QEMU} said {said!r}, expected the name of its terminal")

    def _stop(self) -> None:
        """An emulator whose line is full ignores SIGTERM: the guard kills it."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()

    def close(self) -> None:
        """End the process and give everything back."""
        super().close()
        self._rest.close()
