"""Runs the firmware on this machine, on a serial line that the twin monitors.

    flight program -- pty with a stable name -- tap -- socket -- firmware

A kernel thread without priority moves the bytes of a pty, and every access to a pty, even a
non-blocking poll, waits for that thread (n_tty_poll flushes the buffer's work): tens of
milliseconds on a busy machine (`benchmarks/pty_stall.py`). So the firmware uses a socket instead of
a second pty, and `listen` serves the first pty in a thread of its own, so that nothing else waits.

The tap forwards bytes as they arrive and decodes the board's reports: its valves' edges, in the
host's time. It replaces the cable, so it can also interrupt the connection.

The frame with the shortest delay gives the best estimate of the board's clock.
"""

import os
import pty
import select
import socket
import subprocess
import threading
import tty
from collections import deque
from contextlib import ExitStack, suppress
from pathlib import Path

from firmware_interface.board import Edge
from firmware_interface.compiler import firmware_id, host_program
from firmware_interface.frame import Decoder
from firmware_interface.host_pty import bury
from firmware_interface.messages import Config, State, Status
from firmware_interface.qemu import qemu_command, terminal_of
from firmware_interface.reports import Reports
from firmware_interface.serial_board import monotonic_us
from testbed.core.error import TestbedError

CHUNK = 4096
REMEMBERED = 64  # newest frames used for the clock, because a board's clock may drift
GRACE_S = 2.0
LOOK_S = 0.1  # between two checks for the end


class TapError(TestbedError):
    """The firmware did not start."""


class LineTap:
    """One board and its cable; a context manager. Bytes are forwarded only by `serve`.

    Args:
        config: limits, see `limits.limits_of`.
        boot_nonce: distinguishes this board from others.
        link: path of a symbolic link to the terminal that represents the vehicle's serial port.
        chip: run the image for the board's chip in QEMU instead of the core on this machine.

    Raises:
        TapError, BoardError: the firmware's process did not start correctly.
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
        self.spoken_us = 0  # time of the last bytes from the flight program
        self.silence_us = 0  # longest time that an armed board received nothing
        self._listener: threading.Thread | None = None
        self._over = False

    def __enter__(self) -> "LineTap":
        with ExitStack() as stack:
            near, far = socket.socketpair()
            stack.callback(near.close)
            command = qemu_command(self._config) if self._chip else self._host_command(far.fileno())
            self._process = subprocess.Popen(
                command,
                pass_fds=[far.fileno()],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT if self._chip else None,
                start_new_session=True,
            )
            far.close()
            stack.callback(self._stop)
            assert self._process.stdout is not None
            assert self._process.stdin is not None
            answer = self._process.stdout.readline().decode()
            if self._chip:
                terminal = os.open(terminal_of(answer), os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
                stack.callback(os.close, terminal)
                tty.setraw(terminal)
                self.board_fd = terminal
            elif answer == "ok\n":
                near.setblocking(False)
                self.board_fd = near.fileno()
            else:
                raise TapError(f"the firmware's process answered {answer!r}, expected 'ok'")
            os.set_blocking(self._process.stdout.fileno(), False)
            os.set_blocking(self._process.stdin.fileno(), False)
            self._open_port(stack)
            self._rest = stack.pop_all()
        return self

    def _host_command(self, line: int) -> list[str]:
        identity = [str(firmware_id()), str(self._nonce)]
        return [str(host_program()), self._config.pack().hex(), *identity, f"fd:{line}"]

    def _open_port(self, stack: ExitStack) -> None:
        if _is_taken(self.link):  # on a lab machine it may be a real board
            raise TapError(
                f"{self.link} exists and was not created by a twin: expected an unused path;"
                " set another one with [lab.serial] ports or --ports"
            )
        self.port_fd, other = pty.openpty()
        stack.callback(os.close, self.port_fd)
        stack.callback(os.close, other)  # held open: reads fail while no program uses the port
        tty.setraw(other)
        os.set_blocking(self.port_fd, False)
        fresh = self.link.with_name(f".{self.link.name}-fresh")
        fresh.symlink_to(os.ttyname(other))
        fresh.replace(self.link)
        stack.callback(self._give_back, os.ttyname(other))

    def _give_back(self, terminal: str) -> None:
        """Remove the link if it still points to this terminal."""
        with suppress(OSError):
            if str(self.link.readlink()) == terminal:
                self.link.unlink()

    def __exit__(self, *_: object) -> None:
        self._over = True
        if self._listener is not None:
            self._listener.join()
        self._rest.close()

    def listen(self) -> None:
        """Forward bytes of the flight program in a thread of its own; `serve` does the rest."""
        self._listener = threading.Thread(target=self._listen, name="line", daemon=True)
        self._listener.start()

    def _listen(self) -> None:
        while not self._over:
            if select.select([self.port_fd], [], [], LOOK_S)[0]:
                self._from_port()

    def _stop(self) -> None:
        process = self._process
        if self._chip and process.stdin is not None:
            process.stdin.close()  # ends its guard process
        else:
            process.terminate()
        bury(process, GRACE_S)

    @property
    def pid(self) -> int:
        """Process id of the firmware."""
        return self._process.pid

    @property
    def dead(self) -> bool:
        """Whether the firmware's process has ended, as a board without power."""
        return self._process.poll() is not None

    @property
    def bearing(self) -> bool:
        """Whether bearing air was on at the board's last STATUS."""
        return self._reports.bearing

    def sense(self, supply_mv: int, supply_pa: int) -> None:
        """Set the readings of the board's sensors from now on; no effect on QEMU."""
        if self._chip:
            return
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with suppress(BlockingIOError, BrokenPipeError):
            os.write(self._process.stdin.fileno(), f"sense {supply_mv} {supply_pa}\n".encode())
        with suppress(BlockingIOError):
            os.read(self._process.stdout.fileno(), CHUNK)  # discard its answers

    def power(self, *, on: bool) -> None:
        """Switch the board's power; no effect on QEMU, or if the process has ended."""
        if self._chip or self.dead:
            return
        assert self._process.stdin is not None
        os.set_blocking(self._process.stdin.fileno(), True)
        os.write(self._process.stdin.fileno(), b"up 2\n" if on else b"down\n")
        os.set_blocking(self._process.stdin.fileno(), False)
        if on:  # its clock restarts
            self._reports = Reports()
            self._offsets.clear()

    def serve(self) -> None:
        """Forward available bytes without waiting."""
        if self._listener is None:
            self._from_port()
        now = monotonic_us()
        if data := _read(self.board_fd):
            if self._reports.receive(data, now):
                self._offsets.append(now - self._reports.board_us)
            for frame in self._decoder.feed(data):
                if frame.type == Status.CODE:
                    self.status = Status.unpack(frame.payload)
            if not self.cut:
                _write(self.port_fd, data)

    def _from_port(self) -> None:
        if data := _read(self.port_fd):
            now = monotonic_us()
            if self.status is not None and self.status.state is State.ARMED and not self.cut:
                self.silence_us = max(self.silence_us, now - self.spoken_us)
            self.spoken_us = now
            if not self.cut:
                _write(self.board_fd, data)

    @property
    def fds(self) -> list[int]:
        """File descriptors to poll before calling `serve`."""
        return [self.board_fd] if self._listener is not None else [self.port_fd, self.board_fd]

    def edges(self) -> list[Edge]:
        """Valve edges since the last call, on this machine's monotonic clock [us]."""
        edges = self._reports.take_edges()
        if not edges:
            return []
        offset = min(self._offsets)
        return [Edge(edge.t_us + offset, edge.mask) for edge in edges]


def _is_taken(link: Path) -> bool:
    """Whether the path exists and is not a twin's link; a killed twin leaves its link behind."""
    if not link.is_symlink():
        return link.exists()
    return not str(link.readlink()).startswith("/dev/pts/")


def _read(fd: int) -> bytes:
    try:
        return os.read(fd, CHUNK)
    except (BlockingIOError, OSError):
        return b""


def _write(fd: int, data: bytes) -> None:
    with suppress(BlockingIOError, OSError):  # full, no program reads: bytes are lost, as on a wire
        os.write(fd, data)
