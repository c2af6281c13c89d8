"""`testbed dash`: starts the viewer and its feeder process, and restarts either if it dies."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
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
    Kind,
    ViewerAddress,
    ViewerError,
    check_display,
    free_port,
    listens,
    program,
    start,
    step_back,
)
from testbed.logs.log_reader import LogError, log_of
from testbed.realtime.processes import hung_up
from testbed.run.recorded import check_files

PERIOD_S = 0.2
PATIENCE = 150  # periods until the viewer must accept connections


class Dashboard:
    """The viewer process and the feeder process; each is restarted if it dies."""

    def __init__(self, run: Path, kind: Kind, address: ViewerAddress) -> None:
        self._run, self._kind, self.address = run, kind, address
        self.viewer: subprocess.Popen[bytes] | None = None
        self.feeder: subprocess.Popen[bytes] | None = None
        self.restarts = 0

    def open(self, waited: Callable[[float], bool]) -> None:
        """Start both processes.

        Raises:
            ViewerError: the viewer is not installed or does not start.
        """
        self.viewer = start(self._kind, self.address)
        for _ in range(PATIENCE):
            if listens(self.address):
                break
            if self.viewer.poll() is not None or waited(PERIOD_S):
                raise ViewerError(f"the viewer ended with exit code {self.viewer.poll()}")
        else:
            self.viewer.kill()
            raise ViewerError(f"the viewer accepts no connections after {PATIENCE * PERIOD_S:g} s")
        self._start_feeder()

    def _start_feeder(self) -> None:
        """Start the process that sends the log to the viewer."""
        self.feeder = subprocess.Popen(
            [sys.executable, "-m", "testbed.dashboard.feeder", str(self._run), self.address.data],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            env={"RUST_LOG": "off"} | os.environ,  # else rerun logs over the operator's table
        )  # fmt: skip
        step_back(self.feeder)

    def keep(self, waited: Callable[[float], bool]) -> bool:
        """Restart processes that died; False when the operator has closed the viewer."""
        assert self.viewer is not None
        assert self.feeder is not None
        if (code := self.viewer.poll()) is not None:
            if code == 0:
                return False
            self.feeder.kill()
            self.feeder.wait()
            self.restarts += 1
            self.open(waited)
        elif self.feeder.poll() not in (None, OK, 1):  # 1: it has printed why it has no data
            self.restarts += 1
            self._start_feeder()
        return True

    def close(self) -> None:
        """Kill both; neither has data to save."""
        for process in (self.feeder, self.viewer):
            if process is not None:
                process.kill()
                process.wait()


def address_for(bind: str = LOOPBACK, port: int | None = None) -> ViewerAddress:
    """The given port and the next one, or two free ports."""
    if port is None:
        return ViewerAddress(bind, free_port(bind), free_port(bind))
    return ViewerAddress(bind, port, port + 1)


def show_run(run: Path, kind: Kind, bind: str, port: int | None) -> int:
    """Show a run until the viewer or the terminal is closed, or Ctrl-C."""
    stop = Event()

    def handle(number: int, frame: FrameType | None) -> None:
        stop.set()

    try:
        if (log := log_of(run)).with_name("metrics.json").exists():  # the flight is over
            check_files(log)
    except LogError as error:
        return refuse(error)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:  # as under nohup
            signal.signal(number, handle)
    terminal = os.isatty(2)  # also that of the run which has started this process
    board = Dashboard(run, kind, address_for(bind, port))
    out = Console(highlight=False)
    try:
        board.open(stop.wait)
        if kind == "web":
            out.print(f"dashboard: {board.address.page}", markup=False, soft_wrap=True)
        out.print("press Ctrl-C to end it" if kind == "web" else "close the window to end it")
        sys.stdout.flush()
        while not stop.wait(PERIOD_S) and board.keep(stop.wait):
            if terminal and hung_up(2):
                break
    except ViewerError as error:
        return refuse(error)
    finally:
        board.close()
    return OK


def beside_run(
    folder: Path, kind: str, bind: str = LOOPBACK, port: int | None = None
) -> "subprocess.Popen[bytes]":
    """Start the dashboard of a run that is about to fly, without waiting for it."""
    program()  # raises at once if the viewer is not installed
    check_display(kind)
    words = [sys.executable, "-m", "testbed", "dash", str(folder), "--bind", bind]
    if port is not None:
        words += ["--port", str(port)]
    return subprocess.Popen(
        [*words, "--web"] if kind == "web" else words,
        stdin=subprocess.DEVNULL, stdout=sys.stderr, start_new_session=True,
    )  # fmt: skip


def leave(pages: "Sequence[subprocess.Popen[bytes]]") -> None:
    """After the flight, keep the pages until Ctrl-C at a terminal; else end them at once."""
    if sys.stdin.isatty() and sys.stderr.isatty():
        errors.print("the page stays until Ctrl-C")
        with suppress(KeyboardInterrupt):
            for page in pages:
                page.wait()
    for page in pages:
        page.terminate()
        page.wait()


def play_run(run: Path) -> None:
    """Play a recorded run in a window with time control, until the window is closed."""
    from testbed.dashboard.recording import write_recording

    with TemporaryDirectory() as folder:
        try:
            recording = write_recording(run, Path(folder) / "run.rrd", warn)
            start("window", address_for(), [recording]).wait()
        except (LogError, ViewerError) as error:
            refuse(error)
