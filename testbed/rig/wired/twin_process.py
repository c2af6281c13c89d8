"""The twin's process: cameras, serial ports and firmware of a table, in real time.

    python -m testbed.rig.wired.twin_process EXPERIMENT.toml REPORT.json

That is how a host on the bench starts it: it ends when its standard input does.
"""

import contextlib
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import msgspec

from firmware_interface.compiler import CompilerError
from firmware_interface.limits import LimitsError
from firmware_interface.line_tap import TapError
from firmware_interface.serial_board import BoardError
from testbed.config import ConfigError, Experiment, load
from testbed.files import write_atomic
from testbed.realtime.processes import end_on_terminate, orphaned
from testbed.realtime.scheduling import no_garbage_collection, prefer_process, realtime_priority
from testbed.rig.twin import warm_up
from testbed.rig.wired.server import TableServer, port_of

PRIORITY = 30  # the table does not wait for anybody
FAILURES = (OSError, TapError, BoardError, CompilerError, LimitsError)


def serve(
    experiment: Experiment, ports: Path | None, report: Path | None, *,
    over: Callable[[], bool], say: Callable[[str], None],
) -> None:  # fmt: skip
    """Serve until told to end.

    Args:
        experiment: whose table it is.
        ports: folder in which the vehicles' serial ports appear; None: where the table file says.
        report: file for what became of the table.
        over: whether to end.
        say: is told where the cameras and ports are.

    Raises:
        OSError, TapError, BoardError, CompilerError, LimitsError: a part cannot be had.
    """
    warm_up(experiment)
    with TableServer(experiment, ports) as server:
        wire = experiment.table.lab.mocap
        say(f"NatNet {wire.version} at {wire.server}, commands at {wire.command_port}")
        for vehicle in experiment.vehicles:
            say(f"{vehicle}: {port_of(experiment, vehicle, ports)}")
        signal.signal(signal.SIGUSR1, lambda number, frame: server.cut_next())
        for pid in server.pids.values():  # a chip does not wait for a turn either
            prefer_process(pid, PRIORITY + 10)
        with (
            no_garbage_collection(),
            realtime_priority(PRIORITY),
            contextlib.suppress(KeyboardInterrupt),
        ):
            server.run(over)
        if report is not None:
            write_atomic(report, msgspec.json.encode(server.report()))


def main() -> int:
    """Serve as the child of a host; the exit code."""
    end_on_terminate()
    config, report = (Path(word) for word in sys.argv[1:3])
    try:
        experiment = load(config)
        serve(experiment, None, report, over=orphaned, say=lambda text: None)
    except (ConfigError, *FAILURES) as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    except KeyboardInterrupt:
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
