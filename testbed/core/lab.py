"""Addresses of a lab: cameras, network, serial lines.

By default all addresses are on this machine; only the lab file can name others.
"""

from typing import Annotated, Any, Literal

from msgspec import Meta, Struct, field

from testbed.core.vehicle import Point, Positive

Port = Annotated[int, Meta(ge=1, le=65535)]
Word = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_-]{1,32}$")]


MOCAP_SYSTEMS = ("natnet", "zenoh", "vicon", "qualisys", "vrpn")
THRUSTER_SYSTEMS = ("serial",)


class MocapWire(Struct, frozen=True, forbid_unknown_fields=True):
    """Source and conventions of the poses."""

    system: str = "natnet"  # one of MOCAP_SYSTEMS, or a plug-in
    options: dict[str, Any] = field(default_factory=dict)  # of the plug-in
    server: str = "127.0.0.1"
    interface: str = "127.0.0.1"  # own address towards the server; 0.0.0.0: any
    command_port: Port = 1510
    data_port: Port = 1511
    group: str | None = None  # multicast address of frames; none: sent to each client
    version: Literal["3.1", "4.1"] = "4.1"  # NatNet version of the twin; a server reports its own
    delay_s: Annotated[float, Meta(ge=0.0)] = 0.0  # exposure to arrival, if frames have no stamp
    up: Literal["y", "z"] = "y"  # the axis that points up; Motive's default is y
    origin: Point = (0.0, 0.0)  # of the table's centre, in the floor plane of the cameras [m]
    turn_deg: float = 0.0  # of the table against the cameras, counter-clockwise
    bodies: dict[str, str] = field(default_factory=dict)  # vehicle -> body; default: same name
    # bodies that never move, and where they are on the table: x, y [m], theta [rad]
    reference: dict[str, tuple[float, float, float]] = field(default_factory=dict)


class Network(Struct, frozen=True, forbid_unknown_fields=True):
    """The host's address; all other parties connect to it."""

    lab: Word = "lab"  # first part of every network key
    endpoint: str = "tcp/127.0.0.1:7450"  # in Zenoh's notation; tls/ with keys
    keys: str = ""  # the host's key folder from `testbed lab-keys`; empty: loopback only
    ros2: bool = False  # publish each flight to ROS 2, read-only, see net/ros2.py
    ros2_endpoint: str = "tcp/127.0.0.1:7447"  # of its router, `rmw_zenohd`
    ros2_domain: Annotated[int, Meta(ge=0, le=232)] = 0  # ROS_DOMAIN_ID


class SerialLines(Struct, frozen=True, forbid_unknown_fields=True):
    """Serial ports of the valve boards."""

    ports: dict[str, str] = field(default_factory=dict)  # vehicle -> device
    baud: Annotated[int, Meta(ge=9600)] = 460_800


class ThrusterWire(Struct, frozen=True, forbid_unknown_fields=True):
    """Kind of board that opens the valves, and its options."""

    system: str = "serial"  # one of THRUSTER_SYSTEMS, or a plug-in; serial: the board's firmware
    options: dict[str, Any] = field(default_factory=dict)  # of the plug-in, on every vehicle


class Impairment(Struct, frozen=True, forbid_unknown_fields=True):
    """Simulated delay and loss of incoming messages, for tests."""

    loss: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
    delay_s: Annotated[float, Meta(ge=0.0)] = 0.0
    spread_s: Annotated[float, Meta(ge=0.0)] = 0.0  # the delay is uniform within +- this


class Lab(Struct, frozen=True, forbid_unknown_fields=True):
    """Everything around a table that has an address."""

    mocap: MocapWire = field(default_factory=MocapWire)
    network: Network = field(default_factory=Network)
    serial: SerialLines = field(default_factory=SerialLines)
    thrusters: ThrusterWire = field(default_factory=ThrusterWire)
    impairment: Impairment = field(default_factory=Impairment)
    late_s: Positive = 0.2  # a command older than this on arrival is dropped
