"""Viewer processes: rerun's own program, by default on loopback, with a memory limit.

The `rerun` command that pip installs is a wrapper, and ending it leaves the viewer running; so the
program itself is started. By default that would listen on every interface.
"""

import os
import socket
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Literal

from msgspec import Struct

from testbed.core.error import TestbedError
from testbed.core.extra import pip_install

LOOPBACK = "127.0.0.1"
MEMORY = "1GB"
SERVER_MEMORY = "300MB"
BEHIND = 10  # niceness

Kind = Literal["window", "web", "headless"]


class ViewerError(TestbedError):
    """No viewer can be started."""


class ViewerAddress(Struct, frozen=True):
    """Host and ports of a viewer."""

    bind: str
    port: int  # for data
    web_port: int  # for browsers

    @property
    def data(self) -> str:
        """URL for sending data."""
        return f"rerun+http://{_reachable(self.bind)}:{self.port}/proxy"

    @property
    def page(self) -> str:
        """URL for browsers."""
        host = _reachable(self.bind)
        source = f"rerun%2Bhttp%3A%2F%2F{host}%3A{self.port}%2Fproxy"
        return f"http://{host}:{self.web_port}/?url={source}&theme=dark&hide_welcome_screen"


def _reachable(bind: str) -> str:
    return LOOPBACK if bind in ("0.0.0.0", "::") else bind


def free_port(bind: str = LOOPBACK) -> int:
    """A TCP port of this machine that is free now."""
    with socket.socket() as one:
        one.bind((bind, 0))
        return int(one.getsockname()[1])


def program() -> Path:
    """Path of rerun's viewer program.

    Raises:
        ViewerError: it is not installed.
    """
    try:
        import rerun_cli
    except ImportError:
        raise ViewerError(f"the dashboard needs rerun: {pip_install('dashboard')}") from None
    return Path(rerun_cli.__file__).parent / "rerun"


def command(kind: Kind, address: ViewerAddress, files: Sequence[Path] = ()) -> list[str]:
    """The viewer's command line."""
    words = [
        str(program()), *map(str, files), "--bind", address.bind, "--port", str(address.port),
        "--memory-limit", MEMORY, "--server-memory-limit", SERVER_MEMORY,
    ]  # fmt: skip
    match kind:
        case "web":
            return [*words, "--serve-web", "--web-viewer-port", str(address.web_port)]
        case "headless":
            return [*words, "--headless", "--window-size", "1600x1000", "--hide-welcome-screen"]
        case "window":
            return [*words, "--window-size", "1600x1000", "--hide-welcome-screen"]


def check_display(kind: str) -> None:
    """Raise a ViewerError if a window has no display to open on."""
    if kind == "window" and sys.platform.startswith("linux"):
        if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise ViewerError("no display for a window; try --web")


def start(
    kind: Kind, address: ViewerAddress, files: Sequence[Path] = ()
) -> "subprocess.Popen[bytes]":
    """Start a viewer; its output is discarded."""
    check_display(kind)
    viewer = subprocess.Popen(
        command(kind, address, files),
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        env=os.environ | {"XDG_RUNTIME_DIR": os.environ.get("XDG_RUNTIME_DIR", "/tmp")},
    )  # fmt: skip
    step_back(viewer)
    return viewer


def step_back(process: "subprocess.Popen[bytes]") -> None:
    """Lower a process's priority so that it does not disturb the flight."""
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, process.pid, BEHIND)


def listens(address: ViewerAddress) -> bool:
    """Whether the viewer accepts connections."""
    with socket.socket() as one:
        one.settimeout(0.2)
        return one.connect_ex((_reachable(address.bind), address.port)) == 0
