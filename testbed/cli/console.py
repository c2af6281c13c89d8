"""`testbed console`, and the page beside `testbed run --console`."""

import os
import subprocess
import sys
from pathlib import Path

from testbed.cli.exit_code import OK
from testbed.cli.refusal import refuse
from testbed.config import ConfigError
from testbed.console.process import serve
from testbed.core.error import TestbedError
from testbed.logs.log_reader import LogError, config_of
from testbed.net.flight_note import known_flights, runs


def show_page(run: Path | None, bind: str, port: int | None) -> int:
    """Serve the page of a run until Ctrl-C; None: of the flight on this machine."""
    try:
        folder = run or flying()
        if not (config := config_of(folder)).exists():
            raise ConfigError(str(folder), config.name, "a run folder", "no such file in it")
        serve(folder, bind, port)
    except (TestbedError, LogError) as error:
        return refuse(error)
    return OK


def flying() -> Path:
    """The run folder of the flight on this machine.

    Raises:
        ConfigError: there is none, or more than one.
    """
    found = sorted({f.folder for _, f in known_flights() if f.folder and runs(f)})
    if len(found) != 1:
        raise ConfigError("command line", "RUN", "a run folder, or one flight on this machine",
                          ", ".join(found) or "no flight")  # fmt: skip
    return Path(found[0])


def page_beside(folder: Path, bind: str, port: int) -> "subprocess.Popen[bytes]":
    """Start the page of a run that is about to fly, without waiting for it; port 0: any."""
    words = [sys.executable, "-m", "testbed.console.process"]
    return subprocess.Popen(
        [*words, str(folder), bind, str(port), str(os.getpid())],
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=sys.stderr,
        start_new_session=True,
    )  # fmt: skip
