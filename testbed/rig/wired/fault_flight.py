"""One drill flight on the bench, in a separate process, because the drill may kill the host.

    python -m testbed.rig.wired.fault_flight EXPERIMENT.toml FOLDER

It writes to FOLDER: start.json (the run's time 0 on the monotonic clock [ns], and the ids of its
processes), the twin's report.json, each vehicle's report, and, if the host is not killed,
ending.json (how it ended, the phase, the red checks).
"""

import signal
import sys
from pathlib import Path

import msgspec

from testbed.config import load
from testbed.files import write_atomic
from testbed.realtime.scheduling import steady_memory
from testbed.rig.observers import NullObserver
from testbed.rig.twin import warm_up
from testbed.rig.wired.host import WireRig


def main() -> int:
    """Fly one case of the drill on the bench and write its result."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    experiment, folder = load(Path(sys.argv[1]), []), Path(sys.argv[2])
    warm_up(experiment)
    rig = WireRig(experiment, bench=True, keep=folder / "report.json")

    def started(rig: WireRig) -> None:
        assert rig.results.epoch_ns is not None
        write_atomic(
            folder / "start.json", msgspec.json.encode((rig.results.epoch_ns, rig.children))
        )

    rig.on_start = started
    with steady_memory():
        ending = rig.fly(NullObserver())
    left = ending, rig.supervisor.phase, rig.red
    write_atomic(folder / "ending.json", msgspec.json.encode(left))
    return 0


if __name__ == "__main__":
    sys.exit(main())
