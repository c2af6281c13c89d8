"""Whether an experiment can be flown over wires at all."""

import msgspec

from firmware_interface.messages import VALVES
from testbed.config import ConfigError, Experiment
from testbed.core.spelling import counted
from testbed.net.session import LARGEST
from testbed.rig.firmware_boards import LOCKSTEP
from testbed.rig.wired.process_faults import OF_PROCESSES

SPARE = 6_000  # room for the overhead of a message [bytes]


def check_wires(experiment: Experiment, *, bench: bool) -> None:
    """Check what the wires cannot do.

    Args:
        experiment: to fly.
        bench: with simulated vehicles; else on the table.

    Raises:
        ConfigError: the experiment asks for it.
    """
    if bench and experiment.board in LOCKSTEP:
        expected = "host or qemu on the bench, where time is real"
        raise ConfigError("this rig", "board", expected, experiment.board)
    if not bench and experiment.board != "model":
        expected = "no board on the table: its boards are the lab's"
        raise ConfigError("this rig", "board", expected, experiment.board)
    for name, setup in experiment.vehicles.items():
        jets, wires = len(setup.model.jets), experiment.table.lab.thrusters
        if jets > VALVES and (bench or wires.system == "serial"):
            expected = f"at most {VALVES} jets, the outputs of a board; the twin flies more"
            raise ConfigError("this rig", f"vehicles.{name}.model.jets", expected, f"{jets}")
    if experiment.forks:
        expected = "no [[forks]] on bench and table: only the twin flies them"
        raise ConfigError("this rig", "forks", expected, counted(len(experiment.forks), "fork"))
    if experiment.inject and not bench:
        expected = "no faults on the table: inject them on the twin or on the bench"
        raise ConfigError("this rig", "inject", expected, counted(len(experiment.inject), "fault"))
    for k, one in enumerate(experiment.inject):
        if one.at_s is None and one.kind in OF_PROCESSES:
            expected = f"`at_s`: on the bench {one.kind} needs a time"
            raise ConfigError("this rig", f"inject.{k + 1}", expected, f'event = "{one.event}"')
    size = len(msgspec.json.encode(experiment))
    if size > LARGEST - SPARE:
        expected = f"an experiment of at most {(LARGEST - SPARE) // 1000} kB when encoded"
        found = f"{size // 1000} kB: is the tilt map too fine?"
        raise ConfigError("this rig", "", expected, found)
