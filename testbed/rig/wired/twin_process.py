"""The twin's process: cameras, serial ports and firmware of a table, in real time.

    python -m testbed.rig.wired.twin_process EXPERIMENT.toml REPORT.json

A host on the bench starts it with this command; it ends when its standard input closes.
"""

import contextlib
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np

from firmware_interface.compiler import CompilerError
from firmware_interface.limits import LimitsError
from firmware_interface.line_tap import TapError
from firmware_interface.serial_board import BoardError
from sim_twin.camera import Cameras
from testbed.config import ConfigError, Experiment, load
from testbed.files import write_atomic
from testbed.realtime.processes import orphaned, run_as_child
from testbed.realtime.scheduling import prefer_process, realtime_priority, steady_memory
from testbed.rig.twin import warm_up
from testbed.rig.wired.server import TableServer, pty_path

PRIORITY = 30  # the real table never waits
FAILURES = (OSError, TapError, BoardError, CompilerError, LimitsError)


def serve(
    experiment: Experiment, ports: Path | None, report: Path | None, *,
    over: Callable[[], bool], notify: Callable[[str], None],
) -> None:  # fmt: skip
    """Serve until `over()`.

    Args:
        experiment: its table is served.
        ports: folder for the vehicles' serial ports; None: as in the table file.
        report: file for the report of the flight.
        over: whether to end.
        notify: called with the addresses of cameras and ports.

    Raises:
        OSError, TapError, BoardError, CompilerError, LimitsError: a part is not available.
    """
    warm_up(experiment)
    compile_cameras(experiment)
    with TableServer(experiment, ports) as server:
        wire = experiment.table.lab.mocap
        notify(f"NatNet {wire.version} at {wire.server}, commands at {wire.command_port}")
        for vehicle in experiment.vehicles:
            notify(f"{vehicle}: {pty_path(experiment, vehicle, ports)}")
        signal.signal(signal.SIGUSR1, lambda number, frame: server.cut_next())
        for pid in server.pids.values():  # a real chip never waits for a CPU
            prefer_process(pid, PRIORITY + 10)
        with (
            steady_memory(),
            realtime_priority(PRIORITY),
            contextlib.suppress(KeyboardInterrupt),
        ):
            server.run(over)
        if report is not None:
            write_atomic(report, msgspec.json.encode(server.report()))


def compile_cameras(experiment: Experiment) -> None:
    """Compile what only a server of frames calls: later, boards and vehicles would wait for it."""
    names = list(experiment.vehicles)
    cameras = Cameras(names, experiment.table.mocap, seed=0)
    cameras.expose(np.empty(0), np.empty((0, len(names), 6)), 0.0)
    cameras.arrived(0)


def main() -> None:
    """Serve as the child of a host."""
    config, report = (Path(word) for word in sys.argv[1:3])
    serve(load(config), None, report, over=orphaned, notify=lambda text: None)


if __name__ == "__main__":
    sys.exit(run_as_child(main, (ConfigError, *FAILURES)))
