"""What a lab has around its table, and where to find it: cameras, network, serial lines.

Nothing here listens beyond this machine unless the file names an address that does.
"""

from typing import Annotated, Any, Literal

from msgspec import Meta, Struct, field

from testbed.core.vehicle import Point, Positive

Port = Annotated[int, Meta(ge=1, le=65535)]
Word = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_-]{1,32}$")]


MOCAP_SYSTEMS = ("natnet", "zenoh", "vicon", "qualisys", "vrpn")
THRUSTER_SYSTEMS = ("serial",)


class MocapWire(Struct, frozen=True, forbid_unknown_fields=True):
    """Where poses come from and how to read them."""

    system: str = "natnet"  # one of MOCAP_SYSTEMS, or a plug-in
    options: dict[str, Any] = field(default_factory=dict)  # of the plug-in
    server: str = "127.0.0.1"
    interface: str = "127.0.0.1"  # own address towards it; 0.0.0.0: whichever leads there
    command_port: Port = 1510
    data_port: Port = 1511
    group: str | None = None  # frames are multicast to this address; none: sent to each client
    version: Literal["3.1", "4.1"] = "4.1"  # of NatNet; what the twin speaks, a server says its own
    delay_s: Annotated[float, Meta(ge=0.0)] = 0.0  # exposure to arrival, where no stamp says it
    up: Literal["y", "z"] = "y"  # the axis that points up; Motive's default is y
    origin: Point = (0.0, 0.0)  # of the table's centre, in the floor plane of the cameras [m]
    turn_deg: float = 0.0  # of the table against the cameras, counter-clockwise
    bodies: dict[str, str] = field(default_factory=dict)  # vehicle -> its body; else the same name


class Network(Struct, frozen=True, forbid_unknown_fields=True):
    """The host listens, everybody else dials."""

    lab: Word = "lab"  # first part of every key
    endpoint: str = "tcp/127.0.0.1:7450"  # in Zenoh's words; tls/ with keys
    keys: str = ""  # the host's folder of those that `testbed lab-keys` makes; none: loopback only


class SerialLines(Struct, frozen=True, forbid_unknown_fields=True):
    """The boards."""

    ports: dict[str, str] = field(default_factory=dict)  # vehicle -> device
    baud: Annotated[int, Meta(ge=9600)] = 460_800


class ThrusterWire(Struct, frozen=True, forbid_unknown_fields=True):
    """What opens the valves."""

    system: str = "serial"  # one of THRUSTER_SYSTEMS, or a plug-in; serial: the board's firmware
    options: dict[str, Any] = field(default_factory=dict)  # of the plug-in, on every vehicle


class Weather(Struct, frozen=True, forbid_unknown_fields=True):
    """Harm done on purpose to what comes in from the network, to see what it costs."""

    loss: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
    delay_s: Annotated[float, Meta(ge=0.0)] = 0.0
    spread_s: Annotated[float, Meta(ge=0.0)] = 0.0  # the delay is uniform within +- this


class Lab(Struct, frozen=True, forbid_unknown_fields=True):
    """Everything around a table that has an address."""

    mocap: MocapWire = field(default_factory=MocapWire)
    network: Network = field(default_factory=Network)
    serial: SerialLines = field(default_factory=SerialLines)
    thrusters: ThrusterWire = field(default_factory=ThrusterWire)
    weather: Weather = field(default_factory=Weather)
    late_s: Positive = 0.2  # a command older than this on arrival is dropped
