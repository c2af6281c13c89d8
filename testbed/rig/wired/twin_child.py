"""The twin's process alone, without a host: cameras and boards for a program of this machine."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import tomli_w

from testbed.config import Experiment, dump
from testbed.realtime.processes import ProcessGroup
from testbed.rig.twin import warm_up
from testbed.rig.wired.local import loopback
from testbed.rig.wired.vehicle import await_port


@contextmanager
def twin_child(experiment: Experiment) -> Iterator[Experiment]:
    """Run the twin behind real wires; yields the experiment with its addresses.

    Raises:
        ChildError: it does not start.
    """
    warm_up(experiment)  # compiles on the first run, for longer than one waits for a port
    with ProcessGroup() as children:
        experiment = loopback(experiment, children.folder)
        config = children.folder / "experiment.toml"
        config.write_text(tomli_w.dumps(dump(experiment)), encoding="utf-8")
        report = children.folder / "report.json"
        module = "testbed.rig.wired.twin_process"
        children.start("twin", [sys.executable, "-m", module, str(config), str(report)])

        def gone() -> bool:
            children.check()
            return False

        for port in experiment.table.lab.serial.ports.values():
            await_port(str(Path(port)), gone)
        yield experiment
