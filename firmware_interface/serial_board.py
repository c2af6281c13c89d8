"""The board on a serial port.

One thread owns the port: it reads continuously, writes queued frames, and reopens the port after a
loss. `feed` never waits; if the queue is empty it writes directly, which saves waking the thread.
Of queued plans only the newest is kept, and frames for a lost line are dropped, because late valve
commands are useless.
"""

import contextlib
import os
import select
import threading
import time
from collections import deque
from collections.abc import Sequence

import serial

from firmware_interface.board import Edge
from firmware_interface.frame import CODED_MAX, BadFrameError, decode
from firmware_interface.messages import Cmd, ResetCause
from firmware_interface.reports import Reports
from testbed.core.error import TestbedError

BAUD = 460_800  # 8N1: a plan of 94 bytes takes 2.0 ms
RETRY_S = 0.2  # between attempts to open a lost port
SILENCE_S = 5.0  # timeout: a board sends STATUS at 20 Hz
WAITING_MAX = 64  # limit of queued frames


class BoardError(TestbedError):
    """The board cannot be reached, or does not support the operation."""


def monotonic_us() -> int:
    """The host's monotonic clock [us]."""
    return time.monotonic_ns() // 1000


def is_plan(coded: bytes) -> bool:
    """Whether an encoded frame is a CMD."""
    try:
        return decode(coded).type == Cmd.CODE
    except BadFrameError:
        return False


class SerialBoard:
    """A `Board` behind a serial port, on the wall clock.

    Args:
        port: device, such as /dev/ttyUSB0 or a link to it.
        baud: the firmware's baud rate, see its board file.

    Raises:
        BoardError: the port cannot be opened, or another program has it open.
    """

    virtual_time = False

    def __init__(self, port: str, baud: int = BAUD) -> None:
        self._port_name, self._baud = port, baud
        self._changed = threading.Condition()
        self._reports = Reports()
        self._received = bytearray()
        self._waiting: deque[bytes] = deque()
        self._unsent = b""  # rest of the frame being written
        self._port: serial.Serial | None = None  # while bytes can be exchanged
        self._closing = False
        self.connected = True
        self.reconnects = 0
        self.superseded = 0  # plans dropped for a newer one
        try:
            opened = self._open()
        except (serial.SerialException, OSError) as error:
            raise BoardError(
                f"{port} cannot be opened: {error}; expected the serial port of a board that no"
                " other program uses (`ls -l /dev/serial/by-id` shows what is plugged in)"
            ) from error
        self._wake_read, self._wake_write = os.pipe()
        os.set_blocking(self._wake_write, False)
        self._thread = threading.Thread(target=self._serve, args=(opened,), daemon=True)
        self._thread.start()

    # The thread

    def _open(self) -> serial.Serial:
        port = serial.Serial(self._port_name, self._baud, timeout=0, exclusive=True)
        with contextlib.suppress(ValueError, OSError, NotImplementedError):
            port.set_low_latency_mode(True)  # otherwise FTDI adapters delay bytes by 16 ms
        return port

    def _serve(self, opened: serial.Serial | None) -> None:
        while not self._closing:
            try:
                with opened or self._open() as port:
                    if not self.connected:
                        self.reconnects += 1
                        self.connected = True
                    self._exchange(port)
            except (serial.SerialException, OSError):
                self._lost()
            opened = None

    def _lost(self) -> None:
        with self._changed:
            self.connected = False
            self._waiting.clear()
            self._changed.notify_all()
        select.select([self._wake_read], [], [], RETRY_S)
        self._calm()

    def _calm(self) -> None:
        """Empty the pipe that wakes the thread."""
        while select.select([self._wake_read], [], [], 0)[0]:
            os.read(self._wake_read, 4096)

    def _exchange(self, port: serial.Serial) -> None:
        with self._changed:
            self._unsent = b"\0"  # terminates a partial frame at the board
            self._port = port
        try:
            self._pass_bytes(port)
        finally:
            with self._changed:
                self._port = None  # before it is closed: `feed` writes to it

    def _pass_bytes(self, port: serial.Serial) -> None:
        line = port.fileno()
        while not self._closing:
            # Keep at most about one frame in the driver, where it cannot be withdrawn.
            free = port.out_waiting <= CODED_MAX
            rest = self._next(free=free)
            wait = 0.001 if not free else 0.1
            ready, writable, _ = select.select(
                [line, self._wake_read], [line] if rest else [], [], wait
            )
            if self._wake_read in ready:
                self._calm()
            if line in ready:
                self._hear(os.read(line, 4096))
            if writable:
                with self._changed:
                    self._unsent = rest[os.write(line, rest) :]

    def _next(self, *, free: bool) -> bytes:
        with self._changed:
            if free and not self._unsent and self._waiting:
                self._unsent = self._waiting.popleft()
            return self._unsent

    def _write_now(self, data: bytes) -> bool:
        """Write complete frames if nothing is queued; the thread writes the rest."""
        port = self._port
        if port is None or self._unsent or self._waiting or not data.endswith(b"\0"):
            return False
        try:
            if port.out_waiting > CODED_MAX:
                return False
            self._unsent = data[os.write(port.fileno(), data) :]
        except OSError:  # the thread handles the error
            return False
        return True

    def _hear(self, data: bytes) -> None:
        if not data:
            raise serial.SerialException("the port has disappeared")
        with self._changed:
            self._received += data
            del self._received[:-65536]  # not read: keep the newest
            if self._reports.receive(data, monotonic_us()):
                self._changed.notify_all()

    # The board

    @property
    def now_us(self) -> int:
        """Time since power-on; modulo 71.6 minutes at the first frame received."""
        with self._changed:
            return self._reports.now_us(monotonic_us())

    @property
    def bearing(self) -> bool:
        """Whether bearing air was on at the board's last STATUS."""
        with self._changed:
            return self._reports.bearing

    def feed(self, data: bytes) -> None:
        """Send bytes as soon as the line is free; drops them if the line is lost."""
        with self._changed:
            if not self.connected:
                return
            if self._write_now(data):
                if not self._unsent:
                    return
            else:
                for coded in data.split(b"\0")[:-1]:
                    self._put(coded + b"\0")
                if not data.endswith(b"\0"):
                    self._put(data.rpartition(b"\0")[2])
        with contextlib.suppress(BlockingIOError):  # a full pipe also wakes the thread
            os.write(self._wake_write, b"x")

    def _put(self, coded: bytes) -> None:
        if is_plan(coded[:-1]):
            kept = [one for one in self._waiting if not is_plan(one[:-1])]
            self.superseded += len(self._waiting) - len(kept)
            self._waiting = deque(kept)
        if len(self._waiting) == WAITING_MAX:
            self._waiting.popleft()
        self._waiting.append(coded)

    def run_until(self, t_us: int) -> Sequence[Edge]:
        """Wait until the board reports a time after `t_us`; returns edges since the last call.

        Raises:
            BoardError: the board has stopped sending.
        """
        with self._changed:
            while self._reports.board_us < t_us:
                still = (t_us - self._reports.now_us(monotonic_us())) * 1e-6
                if not self._changed.wait(max(still, 0.0) + SILENCE_S):
                    raise BoardError(
                        f"{self._port_name}: nothing heard for {SILENCE_S:g} s; expected STATUS:"
                        " check power, cable and the baud rate"
                    )
            return self._reports.take_edges()

    def read(self) -> bytes:
        """Bytes the board has sent since the last call."""
        with self._changed:
            data = bytes(self._received)
            self._received.clear()
            return data

    def sense(self, supply_mv: int, supply_pa: int) -> None:
        """Do nothing: a real board measures for itself."""
        raise BoardError("cannot set the sensors of a board on a serial port: they measure")

    def power_cycle(self, cause: ResetCause) -> None:
        """Not supported: a real board must be power-cycled by hand."""
        raise BoardError("a board on a serial port cannot be power-cycled by software")

    def close(self) -> None:
        """Stop the thread and close the port."""
        self._closing = True
        with contextlib.suppress(BlockingIOError):
            os.write(self._wake_write, b"x")
        self._thread.join()
        os.close(self._wake_read)
        os.close(self._wake_write)
