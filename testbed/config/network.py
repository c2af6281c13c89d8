"""Validates a lab's network: addresses, and one body and port per vehicle.

A public address without keys and unused keys are errors, too.
"""

import ipaddress
import re
from collections.abc import Iterator
from ipaddress import IPv4Address
from itertools import combinations
from pathlib import Path

from testbed.config.error import Violation, show
from testbed.config.experiment import Experiment
from testbed.net.credentials import untrusted

NAME = r"(?=.*[A-Za-z])[A-Za-z0-9_-]{1,63}(\.[A-Za-z0-9_-]{1,63})*\.?"  # of a machine
ROS_NAME = r"[A-Za-z_][A-Za-z0-9_]*"  # of a part of a topic


def bad_network(experiment: Experiment) -> Iterator[Violation]:
    """Find errors in `[lab]`: cameras, keys, endpoint, ports; and names that ROS 2 refuses."""
    yield from _mocap(experiment)
    yield from _shared(experiment)
    network = experiment.table.lab.network
    keys = Path(network.keys) if network.keys else None
    if (why := untrusted(network.endpoint, keys)) is not None:
        at = ("table", "lab", "network", "endpoint")
        yield Violation(at, why.expected, show(network.endpoint))
    if (why := untrusted(network.ros2_endpoint, None)) is not None:
        at = ("table", "lab", "network", "ros2_endpoint")
        yield Violation(at, why.expected, show(network.ros2_endpoint))
    for name in experiment.vehicles if network.ros2 else ():
        if not re.fullmatch(ROS_NAME, name, re.ASCII):
            expected = "a name for topics of ROS 2: letters, digits and _, no digit first"
            yield Violation(("vehicles", name), expected, show(name))


def _mocap(experiment: Experiment) -> Iterator[Violation]:
    wire, key = experiment.table.lab.mocap, ("table", "lab", "mocap")
    if wire.system == "zenoh":
        return
    own = _ipv4(wire.interface)
    if own is None or own.is_multicast:
        expected = "an IPv4 address of the vehicle's computer, or 0.0.0.0: whichever leads there"
        yield Violation((*key, "interface"), expected, show(wire.interface))
    if wire.group is not None and ((to := _ipv4(wire.group)) is None or not to.is_multicast):
        expected = "the IPv4 address of a group, from 224.0.0.0 to 239.255.255.255"
        yield Violation((*key, "group"), expected, show(wire.group))
    if wire.system != "natnet":
        return
    there = _ipv4(wire.server)
    if there is None and not re.fullmatch(NAME, wire.server, re.ASCII):
        expected = "the name or the IPv4 address of the machine that the cameras' program runs on"
        yield Violation((*key, "server"), expected, show(wire.server))


def _ipv4(text: str) -> IPv4Address | None:
    try:
        return ipaddress.IPv4Address(text)
    except ValueError:
        return None


def _shared(experiment: Experiment) -> Iterator[Violation]:
    """Vehicles that share a body or a serial port in the table file."""
    lab = experiment.table.lab
    for a, b in combinations(experiment.vehicles, 2):
        if lab.mocap.bodies.get(a, a) == lab.mocap.bodies.get(b, b):
            key = ("table", "lab", "mocap", "bodies", b if b in lab.mocap.bodies else a)
            yield Violation(
                key, f"a body for {a} and another for {b}", show(lab.mocap.bodies[key[-1]])
            )
        if a in lab.serial.ports and lab.serial.ports[a] == lab.serial.ports.get(b):
            key = ("table", "lab", "serial", "ports", b)
            yield Violation(key, f"another port than that of {a}", show(lab.serial.ports[b]))
