"""An experiment whose lab is this machine: every address on loopback."""

import socket
from pathlib import Path

from msgspec.structs import replace

from testbed.config import Experiment
from testbed.core.lab import MocapWire, Network, ThrusterWire
from testbed.core.vehicle import Gauges

HERE = "127.0.0.1"


def local(experiment: Experiment) -> Experiment:
    """The experiment with the default addresses of a lab file, so that processes find each other.

    It has no keys, because their certificates are for the lab's addresses, and no serial ports,
    because a twin creates them in the folder `--ports`.
    """
    ports = MocapWire().command_port, MocapWire().data_port
    return _with_lab(experiment, Network().endpoint, {}, ports, keys="")


def loopback(experiment: Experiment, folder: Path) -> Experiment:
    """The experiment with free ports and serial lines in `folder`, for a separate bench."""
    network = experiment.table.lab.network
    endpoint = f"{'tls' if network.keys else 'tcp'}/{HERE}:{free_port(socket.SOCK_STREAM)}"
    lines = {name: str(folder / f"serial-{name}") for name in experiment.vehicles}
    ports = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_DGRAM)
    if experiment.board == "qemu":
        experiment = without_gauges(experiment)
    return _with_lab(experiment, endpoint, lines, ports, keys=network.keys)


def _with_lab(
    experiment: Experiment, endpoint: str, lines: dict[str, str], ports: tuple[int, int], *,
    keys: str,
) -> Experiment:  # fmt: skip
    table = experiment.table
    # what a twin speaks instead of a lab's cameras
    system = "zenoh" if table.lab.mocap.system == "zenoh" else "natnet"
    wire = replace(
        table.lab.mocap, system=system, options={}, server=HERE, interface=HERE,
        command_port=ports[0], data_port=ports[1], group=None,
    )  # fmt: skip
    network = replace(table.lab.network, endpoint=endpoint, keys=keys)
    serial = replace(table.lab.serial, ports=lines)
    lab = replace(table.lab, mocap=wire, network=network, serial=serial, thrusters=ThrusterWire())
    return replace(experiment, table=replace(table, lab=lab))


def free_port(kind: int) -> int:
    """A port of the loopback interface that is free now."""
    with socket.socket(socket.AF_INET, kind) as one:
        one.bind((HERE, 0))
        return int(one.getsockname()[1])


def without_gauges(experiment: Experiment) -> Experiment:
    """The experiment without pressure and battery gauges: QEMU's chip has no converter."""
    blind = Gauges(supply=False, battery=False)
    vehicles = {
        name: replace(setup, model=replace(setup.model, gauges=blind))
        for name, setup in experiment.vehicles.items()
    }
    return replace(experiment, vehicles=vehicles)
