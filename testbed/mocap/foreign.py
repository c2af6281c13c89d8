"""Vicon, Qualisys and VRPN through the `motioncapture` package, in a separate process.

The package gives neither the time nor the number of an exposure, its calls may block for ever, and
some of its versions crash on some streams. So it runs in a child process that can be killed: poses
come over a pipe, stamped on arrival, and a watchdog restarts the child when it dies or is silent.
The age of a pose on arrival is taken from `delay_s` of the table file's [lab.mocap].
"""

import os
import struct
import subprocess
import sys
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

import msgspec

from testbed.core.extra import pip_install
from testbed.core.lab import MocapWire
from testbed.mocap.exposure import Exposure, Sighting
from testbed.realtime.wall_clock import monotonic_ns

SILENCE_NS = 2_000_000_000  # longest silence of a child after its first message
START_NS = 10_000_000_000  # longest silence before its first message
AGAIN_NS = 500_000_000  # between two starts, so that a child that dies at once costs little
GIVEN_UP = 0  # deadline of a child that is not waited for
LONGEST = 1 << 20  # longest message [bytes]; a longer one is not a message
PACKAGE = "motioncapture"
PROGRAM = Path(__file__).with_name("foreign_process.py")
HEAD = struct.Struct("<I")
Bodies = dict[str, tuple[float, float, float, float, float, float, float]]


class ForeignSource:
    """A `MocapSource`.

    Args:
    wire: from the table file.
    program: script of the process; tests pass faulty ones.

    Raises:
        OSError: the package is not installed.
    """

    def __init__(self, wire: MocapWire, program: Path = PROGRAM) -> None:
        if program == PROGRAM and find_spec(PACKAGE) is None:
            raise OSError(
                f"[lab.mocap] system = {wire.system!r} needs the package {PACKAGE}, which is not"
                f" installed: {pip_install('mocap')}"
            )
        self._wire, self._program = wire, program
        self._decode = msgspec.msgpack.Decoder(tuple[int, int, Bodies]).decode
        self._known: set[str] = set()
        self.starts = self.bad = 0
        self._start()

    def _start(self) -> None:
        w = self._wire
        settings = {"hostname": w.server, "interface_ip": w.interface}
        if w.system == "natnet":
            settings["port_command"] = str(w.command_port)
        system = {"natnet": "optitrack"}.get(w.system, w.system)
        self._child = subprocess.Popen(
            [sys.executable, "-P", self._program, system, msgspec.json.encode(settings).decode()],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )
        assert self._child.stdout is not None
        os.set_blocking(self._child.stdout.fileno(), False)
        self._rest = b""
        self._again = monotonic_ns() + AGAIN_NS
        self._due = monotonic_ns() + START_NS
        self.starts += 1

    def poll(self) -> list[Exposure]:
        """See `MocapSource`."""
        assert self._child.stdout is not None
        with suppress(BlockingIOError):
            while data := os.read(self._child.stdout.fileno(), 65536):
                self._rest += data
        if self._due == GIVEN_UP:
            self._rest = b""
        exposures: list[Exposure] = []
        while len(self._rest) >= HEAD.size:
            size = HEAD.unpack_from(self._rest)[0]
            body = self._rest[HEAD.size : HEAD.size + size]
            if len(body) < size <= LONGEST:
                break
            self._rest = self._rest[HEAD.size + size :]
            try:
                exposures.append(self._expose(body))
            except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
                self.bad += 1  # the start of the next message is unknown
                self._rest, self._due = b"", GIVEN_UP
        now = monotonic_ns()
        if exposures and self._due != GIVEN_UP:
            self._due = now + SILENCE_NS
        elif (self._child.poll() is not None or now > self._due) and now > self._again:
            self._end()
            self._start()
        return exposures

    def _expose(self, body: bytes) -> Exposure:
        number, arrived, bodies = self._decode(body)
        self._known |= bodies.keys()
        seen = {name: Sighting(b[:3], b[3:], tracked=True) for name, b in bodies.items()}
        nowhere = Sighting((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), tracked=False)
        lost = dict.fromkeys(self._known - bodies.keys(), nowhere)
        exposed = arrived - round(1e9 * self._wire.delay_s)
        return Exposure(number, exposed, arrived, seen | lost)

    def _end(self) -> None:
        self._child.kill()
        self._child.wait()
        for pipe in (self._child.stdin, self._child.stdout):
            if pipe is not None:
                pipe.close()

    def close(self) -> None:
        """See `MocapSource`."""
        self._end()
