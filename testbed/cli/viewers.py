"""Processes that show a flight while it flies: the dashboard, the operator's page, ROS 2 topics."""

import subprocess
from pathlib import Path

from testbed.config import ConfigError, Experiment
from testbed.dashboard.viewer import LOOPBACK


class Viewers:
    """What was started beside a flight; none of it can delay the flight.

    Args:
        view: "window" or "web" for the dashboard; None: no dashboard.
        console: port of the operator's page, 0: its default; None: no page.
        bind: network address of what is served; None: loopback.
        port: data port of the dashboard; None: a free one.

    Raises:
        ConfigError: an address is given and nothing is served there.
    """

    def __init__(
        self, view: str | None, console: int | None, bind: str | None, port: int | None
    ) -> None:
        if view is None and (port or (bind and console is None)):
            found = f"--bind {bind}" if bind else f"--port {port}"
            expected = "--web or --view, which it belongs to"
            raise ConfigError("command line", "", expected, found)
        self._view, self._console, self._bind, self._port = view, console, bind or LOOPBACK, port
        self._board: subprocess.Popen[bytes] | None = None
        self._page: subprocess.Popen[bytes] | None = None
        self._ros2: subprocess.Popen[bytes] | None = None

    def start(self, experiment: Experiment, folder: Path) -> None:
        """Start all for a run that is about to fly, without waiting for them.

        Raises:
            ViewerError: the dashboard's viewer is not installed.
        """
        if self._view is not None:
            from testbed.cli.dash import beside_run

            self._board = beside_run(folder, self._view, self._bind, self._port)
        if self._console is not None:
            from testbed.cli.console import page_beside

            self._page = page_beside(folder, self._bind, self._console)
        if experiment.table.lab.network.ros2:
            from testbed.cli.ros2 import publisher_beside

            self._ros2 = publisher_beside(folder, experiment.table.lab.network)

    def end(self) -> None:
        """End all at once, because there is no flight to show."""
        for one in (self._board, self._page, self._ros2):
            if one is not None:
                one.terminate()
                one.wait()

    def finish(self) -> None:
        """After the flight: publish the last messages; at a terminal, pages stay until Ctrl-C."""
        if self._ros2 is not None:
            from testbed.cli.ros2 import end

            end(self._ros2)
        served = (self._board if self._view == "web" else None, self._page)
        if pages := [one for one in served if one is not None]:
            from testbed.cli.dash import leave

            leave(pages)
