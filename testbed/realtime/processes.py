"""Child processes of a run; none of them outlives it.

When the parent ends, a child's standard input closes; the child then brings its vehicle to rest and
exits. A guardian, a small process that outlives the parent for this purpose, kills a child that
hangs or is suspended.
"""

import contextlib
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from time import monotonic

from testbed.core.error import TestbedError
from testbed.realtime.heartbeat import heartbeat

GRACE_S = 12.0  # time for a vehicle to brake
BEAT_S = 0.5  # between two heartbeats while a child ends
LEAVE_S = 2.0  # time for a guardian without children to exit
GUARDIAN = Path(__file__).with_name("guardian.py")


class ChildError(TestbedError):
    """A process of the run ended unexpectedly."""


class ProcessGroup:
    """The processes of a run and their shared folder; a context manager."""

    def __init__(self, grace_s: float = GRACE_S) -> None:
        self._grace_s = grace_s
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> "ProcessGroup":
        self.folder = Path(tempfile.mkdtemp(prefix="airbearing-"))
        self._guardian = subprocess.Popen(
            [sys.executable, "-SEI", GUARDIAN, str(self._grace_s), str(self.folder)],
            stdin=subprocess.PIPE,
            start_new_session=True,
        )
        return self

    def __exit__(self, *_: object) -> None:
        self.end()
        assert self._guardian.stdin is not None
        self._guardian.stdin.close()
        try:
            self._guardian.wait(LEAVE_S)  # all children have ended
        except subprocess.TimeoutExpired:
            self._guardian.kill()
            self._guardian.wait()
        shutil.rmtree(self.folder, ignore_errors=True)

    def start(self, name: str, words: Sequence[str]) -> int:
        """Start a process; its stderr is kept for error messages."""
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
        """Exit code of a process, negative for a signal; None: it runs."""
        return self._running[name].poll()

    def kill(self, name: str) -> None:
        """Kill a process that does not respond."""
        self._running[name].kill()

    def pid(self, name: str) -> int:
        """The process id of a child."""
        return self._running[name].pid

    def check(self) -> None:
        """Check that all processes run.

        Raises:
            ChildError: one has ended; contains its last output.
        """
        for name, process in self._running.items():
            if process.poll() is not None:
                raise ChildError(f"{name} ended with code {process.returncode}{self._words(name)}")

    def _words(self, name: str) -> str:
        text = (self.folder / f"{name}.log").read_text(errors="replace").strip()
        return f": {text[-2000:]}" if text else ""

    def end(self, names: Collection[str] | None = None) -> None:
        """End these or all processes: ask, wait, kill."""
        some = {n: p for n, p in self._running.items() if names is None or n in names}
        for process in some.values():
            assert process.stdin is not None
            with contextlib.suppress(BrokenPipeError):
                process.stdin.close()
        for process in some.values():
            end = monotonic() + self._grace_s
            while process.poll() is None and monotonic() < end:
                heartbeat().beat()  # this process does not hang
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(min(BEAT_S, self._grace_s))
            if process.poll() is None:
                process.kill()
                process.wait()
        self._running = {n: p for n, p in self._running.items() if n not in some}


def orphaned() -> bool:
    """In a child: whether the parent has ended or asked the child to end."""
    if not select.select([0], [], [], 0)[0]:
        return False
    return os.read(0, 1) == b""


def hung_up(terminal: int) -> bool:
    """Whether the terminal behind a descriptor was closed."""
    poll = select.poll()
    poll.register(terminal, 0)  # hang-ups are always reported
    return bool(poll.poll(0))


def run_as_child(work: Callable[[], None], failures: tuple[type[Exception], ...]) -> int:
    """Run `work` as the child of a host; returns the exit code."""
    end_on_terminate()
    try:
        work()
    except failures as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    except KeyboardInterrupt:
        return 1
    return 0


def end_on_terminate() -> None:
    """Make SIGTERM and a closed terminal end this process in order, like Ctrl-C."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # as under nohup
        signal.signal(signal.SIGHUP, signal.default_int_handler)
