"""`testbed dash`: a viewer and the process that tells it, both kept alive."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event
from types import FrameType

from rich.console import Console

from testbed.cli.exit_code import OK
from testbed.cli.refusal import errors, refuse, warn
from testbed.dashboard.viewer import (
    LOOPBACK,
    Address,
    Kind,
    ViewerError,
    free_port,
    listens,
    program,
    start,
    step_back,
)
from testbed.logs.log_reader import LogError, log_of

PERIOD_S = 0.2
PATIENCE = 150  # periods until a viewer must listen


class Dashboard:
    """Two processes: the viewer, and the one that tells it. Whoever dies is started again."""

    def __init__(self, run: Path, kind: Kind, address: Address) -> None:
        self._run, self._kind, self.address = run, kind, address
        self.viewer: subprocess.Popen[bytes] | None = None
        self.feeder: subprocess.Popen[bytes] | None = None
        self.restarts = 0

    def open(self, waited: Callable[[float], bool]) -> None:
        """Start both.

        Raises:
            ViewerError: there is no viewer here, or it does not come up.
        """
        self.viewer = start(self._kind, self.address)
        for _ in range(PATIENCE):
            if listens(self.address):
                break
            if self.viewer.poll() is not None or waited(PERIOD_S):
                raise ViewerError(f"the viewer ended with {self.viewer.poll()}")
        else:
            self.viewer.kill()
            raise ViewerError("the viewer does not listen")
        self._tell()

    def _tell(self) -> None:
        self.feeder = subprocess.Popen(
            [sys.executable, "-m", "testbed.dashboard.feeder", str(self._run), self.address.data],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            env={"RUST_LOG": "off"} | os.environ,  # rerun would write into the operator's table
        )  # fmt: skip
        step_back(self.feeder)

    def keep(self, waited: Callable[[float], bool]) -> bool:
        """Look after both; false when the operator has closed the viewer."""
        assert self.viewer is not None
        assert self.feeder is not None
        if (code := self.viewer.poll()) is not None:
            if code == 0:
                return False
            self.feeder.kill()
            self.feeder.wait()
            self.restarts += 1
            self.open(waited)
        elif self.feeder.poll() not in (None, OK, 1):  # 1: it said why there is nothing to tell
            self.restarts += 1
            self._tell()
        return True

    def close(self) -> None:
        """End both; neither has anything to lose."""
        for process in (self.feeder, self.viewer):
            if process is not None:
                process.kill()
                process.wait()


def address_for(bind: str = LOOPBACK, port: int | None = None) -> Address:
    """Ports that are free, or the one asked for and the next."""
    if port is None:
        return Address(bind, free_port(bind), free_port(bind))
    return Address(bind, port, port + 1)


def show_run(run: Path, kind: Kind, bind: str, port: int | None) -> int:
    """Show a run until the viewer is closed or Ctrl-C."""
    stop = Event()

    def handle(number: int, frame: FrameType | None) -> None:
        stop.set()

    try:
        log_of(run)
    except LogError as error:
        return refuse(error)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, handle)
    board = Dashboard(run, kind, address_for(bind, port))
    out = Console(highlight=False)
    try:
        board.open(stop.wait)
        if kind == "web":
            out.print(f"dashboard: {board.address.page}", markup=False, soft_wrap=True)
        out.print("Ctrl-C ends it" if kind == "web" else "close the window to end it")
        sys.stdout.flush()
        while not stop.wait(PERIOD_S) and board.keep(stop.wait):
            pass
    except ViewerError as error:
        return refuse(error)
    finally:
        board.close()
    return OK


def beside_run(
    folder: Path, kind: str, bind: str = LOOPBACK, port: int | None = None
) -> "subprocess.Popen[bytes]":
    """Open the dashboard beside a run that is about to be flown, and do not wait for it."""
    program()  # or say at once that there is none
    words = [sys.executable, "-m", "testbed", "dash", str(folder), "--bind", bind]
    if port is not None:
        words += ["--port", str(port)]
    return subprocess.Popen(
        [*words, "--web"] if kind == "web" else words,
        stdin=subprocess.DEVNULL, stdout=sys.stderr, start_new_session=True,
    )  # fmt: skip


def leave(board: "subprocess.Popen[bytes]") -> None:
    """The flight is over: at a terminal the page stays until Ctrl-C, elsewhere it ends at once."""
    if sys.stdin.isatty() and sys.stderr.isatty():
        errors.print("the dashboard stays until Ctrl-C")
        with suppress(KeyboardInterrupt):
            board.wait()
    board.terminate()
    board.wait()


def play_run(run: Path) -> None:
    """A recorded run in a window, with time control; returns when it is closed."""
    from testbed.dashboard.recording import write_recording

    with TemporaryDirectory() as folder:
        try:
            recording = write_recording(run, Path(folder) / "run.rrd", warn)
            start("window", address_for(), [recording]).wait()
        except (LogError, ViewerError) as error:
            refuse(error)
