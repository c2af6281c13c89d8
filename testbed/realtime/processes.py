"""Processes of a run, none of which outlives it.

A child is told that its parent is gone by the end of its standard input; it then brings its vehicle
to rest and ends by itself. One that cannot, because it hangs or is stopped, is ended by a guardian:
a small process that outlives the parent by just that.
"""

import contextlib
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Collection, Sequence
from pathlib import Path

from testbed.core.error import TestbedError

GRACE_S = 12.0  # for a vehicle that brakes
LEAVE_S = 2.0  # for a guardian that has nothing to guard any more
GUARDIAN = """
import os, select, shutil, signal, sys
grace, folder, fds = float(sys.argv[1]), sys.argv[2], []
for line in sys.stdin:
    try:
        fds.append(os.pidfd_open(int(line)))
    except OSError:
        pass
left = set(fds)
poll = select.poll()
for fd in fds:
    poll.register(fd, select.POLLIN)
import time
end = time.monotonic() + grace
while left and (rest := end - time.monotonic()) > 0:
    for fd, _ in poll.poll(1e3 * rest):
        poll.unregister(fd)
        left.discard(fd)
for fd in left:
    try:
        signal.pidfd_send_signal(fd, signal.SIGKILL)
    except OSError:
        pass
shutil.rmtree(folder, ignore_errors=True)
"""


class ChildError(TestbedError):
    """A process of the run has ended on its own."""


class ProcessGroup:
    """The processes of a run and a folder for what they share; a context manager."""

    def __init__(self, grace_s: float = GRACE_S) -> None:
        self._grace_s = grace_s
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> "ProcessGroup":
        self.folder = Path(tempfile.mkdtemp(prefix="airbearing-"))
        self._guardian = subprocess.Popen(
            [sys.executable, "-SEI", "-c", GUARDIAN, str(self._grace_s), str(self.folder)],
            stdin=subprocess.PIPE,
            start_new_session=True,
        )
        return self

    def __exit__(self, *_: object) -> None:
        self.end()
        assert self._guardian.stdin is not None
        self._guardian.stdin.close()
        try:
            self._guardian.wait(LEAVE_S)  # nobody is left for it
        except subprocess.TimeoutExpired:
            self._guardian.kill()
            self._guardian.wait()
        shutil.rmtree(self.folder, ignore_errors=True)

    def start(self, name: str, words: Sequence[str]) -> int:
        """Start one; what it says on stderr is kept in case it fails."""
        with (self.folder / f"{name}.log").open("wb") as log:
            process = subprocess.Popen(
                words,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=log,
                start_new_session=True,  # Ctrl-C is for the parent
            )
        self._running[name] = process
        assert self._guardian.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._guardian.stdin.write(f"{process.pid}\n".encode())
            self._guardian.stdin.flush()
        return process.pid

    def ended(self, name: str) -> int | None:
        """The exit code of one, negative for a signal; None: it runs."""
        return self._running[name].poll()

    def kill(self, name: str) -> None:
        """End one that does not listen any more."""
        self._running[name].kill()

    def pid(self, name: str) -> int:
        """Of one."""
        return self._running[name].pid

    def check(self) -> None:
        """See that all are there.

        Raises:
            ChildError: one is not; its last words.
        """
        for name, process in self._running.items():
            if process.poll() is not None:
                raise ChildError(f"{name} ended with code {process.returncode}{self._words(name)}")

    def _words(self, name: str) -> str:
        text = (self.folder / f"{name}.log").read_text(errors="replace").strip()
        return f": {text[-2000:]}" if text else ""

    def end(self, names: Collection[str] | None = None) -> None:
        """End these, or all: ask, wait, insist."""
        some = {n: p for n, p in self._running.items() if names is None or n in names}
        for process in some.values():
            assert process.stdin is not None
            with contextlib.suppress(BrokenPipeError):
                process.stdin.close()
        for process in some.values():
            try:
                process.wait(self._grace_s)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._running = {n: p for n, p in self._running.items() if n not in some}


def orphaned() -> bool:
    """In a child: whether the parent has ended, or said that it is time to."""
    if not select.select([0], [], [], 0)[0]:
        return False
    return os.read(0, 1) == b""


def end_on_terminate() -> None:
    """SIGTERM and a closed terminal end this process as Ctrl-C does, and all is closed in order."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # as under nohup
        signal.signal(signal.SIGHUP, signal.default_int_handler)
