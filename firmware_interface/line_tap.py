"""The firmware on this machine, on a serial line that a twin listens in on.

    whoever flies -- pty with a stable name -- tap -- pty -- firmware's process

The tap passes bytes on as they come and reads what the board reports: its valves' edges, in the
host's time. It stands where the cable is, so it can also be cut.

The board's clock against the host's: of all frames the one that was quickest tells it best.
"""

import os
import pty
import subprocess
import tty
from collections import deque
from contextlib import ExitStack, suppress
from pathlib import Path

from firmware_interface.board import Edge
from firmware_interface.compiler import firmware_id, host_program
from firmware_interface.frame import Decoder
from firmware_interface.host_pty import bury
from firmware_interface.messages import Config, Status
from firmware_interface.qemu import qemu_command, terminal_of
from firmware_interface.reports import Reports
from firmware_interface.serial_board import monotonic_us

CHUNK = 4096
REMEMBERED = 64  # frames that tell the clock; a board's clock may drift
GRACE_S = 2.0


class TapError(Exception):
    """The firmware did not start."""


class LineTap:
    """One board and its cable; a context manager. It does nothing until `serve` is called.

    Args:
        config: limits, see `limits.limits_of`.
        boot_nonce: tells this board from others.
        link: becomes a symbolic link to the terminal that stands for the vehicle's serial port.
        chip: run the image for the board's chip in QEMU, not the core on this machine.

    Raises:
        TapError, BoardError: the firmware's process did not start as it should.
        CompilerError: the firmware cannot be built here.
    """

    def __init__(self, config: Config, boot_nonce: int, link: Path, *, chip: bool = False) -> None:
        self._config, self._nonce, self.link, self._chip = config, boot_nonce, link, chip
        self._reports = Reports()
        self._decoder = Decoder()
        self.status: Status | None = None  # the newest
        self._offsets: deque[int] = deque(maxlen=REMEMBERED)
        where = "an STM32F405 in QEMU" if chip else "this machine"
        self.board_name = f"firmware {firmware_id():08x} on {where}, behind a pty"
        self.cut = False
        self.spoken_us = 0  # when whoever flies said something last

    def __enter__(self) -> "LineTap":
        with ExitStack() as stack:
            inner = self.link.with_name(f".{self.link.name}-board")
            command = qemu_command(self._config) if self._chip else self._host_command(inner)
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT if self._chip else None,
                start_new_session=True,
            )
            stack.callback(self._stop)
            assert self._process.stdout is not None
            assert self._process.stdin is not None
            answer = self._process.stdout.readline().decode()
            if self._chip:
                terminal = terminal_of(answer)
            elif answer == "ok\n":
                terminal = str(inner)
            else:
                raise TapError(f"the firmware's process answered {answer!r}, expected 'ok'")
            os.set_blocking(self._process.stdout.fileno(), False)
            os.set_blocking(self._process.stdin.fileno(), False)
            self.board_fd = os.open(terminal, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            stack.callback(os.close, self.board_fd)
            tty.setraw(self.board_fd)
            self._open_port(stack)
            self._rest = stack.pop_all()
        return self

    def _host_command(self, link: Path) -> list[str]:
        identity = [str(firmware_id()), str(self._nonce)]
        return [str(host_program()), self._config.pack().hex(), *identity, str(link)]

    def _open_port(self, stack: ExitStack) -> None:
        self.port_fd, other = pty.openpty()
        stack.callback(os.close, self.port_fd)
        stack.callback(os.close, other)  # held open: or reading fails while nobody has the port
        tty.setraw(other)
        os.set_blocking(self.port_fd, False)
        fresh = self.link.with_name(f".{self.link.name}-fresh")
        fresh.symlink_to(os.ttyname(other))
        fresh.replace(self.link)
        stack.callback(self.link.unlink, missing_ok=True)

    def __exit__(self, *_: object) -> None:
        self._rest.close()

    def _stop(self) -> None:
        process = self._process
        if self._chip and process.stdin is not None:
            process.stdin.close()  # its guard waits for that
        else:
            process.terminate()
        bury(process, GRACE_S)

    @property
    def pid(self) -> int:
        """Of the firmware's process."""
        return self._process.pid

    @property
    def bearing(self) -> bool:
        """Whether bearing air was on at the board's last STATUS."""
        return self._reports.bearing

    def sense(self, supply_mv: int, supply_pa: int) -> None:
        """What the board's sensors say from now on; QEMU has none."""
        if self._chip:
            return
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with suppress(BlockingIOError, BrokenPipeError):
            os.write(self._process.stdin.fileno(), f"sense {supply_mv} {supply_pa}\n".encode())
        with suppress(BlockingIOError):
            os.read(self._process.stdout.fileno(), CHUNK)  # its answers

    def serve(self) -> None:
        """Pass on what is there; does not wait."""
        now = monotonic_us()
        if data := _read(self.port_fd):
            self.spoken_us = now
            if not self.cut:
                _write(self.board_fd, data)
        if data := _read(self.board_fd):
            if self._reports.hear(data, now):
                self._offsets.append(now - self._reports.board_us)
            for frame in self._decoder.feed(data):
                if frame.type == Status.CODE:
                    self.status = Status.unpack(frame.payload)
            if not self.cut:
                _write(self.port_fd, data)

    def edges(self) -> list[Edge]:
        """What the valves did since the last call, on this machine's monotonic clock [us]."""
        edges = self._reports.take_edges()
        if not edges:
            return []
        offset = min(self._offsets)
        return [Edge(edge.t_us + offset, edge.mask) for edge in edges]


def _read(fd: int) -> bytes:
    try:
        return os.read(fd, CHUNK)
    except (BlockingIOError, OSError):
        return b""


def _write(fd: int, data: bytes) -> None:
    with suppress(BlockingIOError, OSError):  # full, because nobody reads: it is lost, as on a wire
        os.write(fd, data)
