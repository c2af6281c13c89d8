"""What the parties say to each other besides states and setpoints."""

from hashlib import sha256
from typing import Literal

import msgspec
from msgspec import Struct

from testbed.core.types import Tick
from testbed.flight.arming import Readiness


class Look(Struct, frozen=True, tag=True):
    """Say how you are. Answered by `Ready` or `Refused`."""


class Start(Struct, frozen=True, tag=True):
    """Fly. Answered by `Accepted` or `Refused`."""

    session: int
    epoch_ns: int  # the run's time 0 on the host's monotonic clock
    ticket: int  # that the vehicle has given to its host, see `roll`


class Stop(Struct, frozen=True, tag=True):
    """End the flight: come to rest, then shut the air off."""

    reason: str
    at_once: bool = False  # valves and air, without a brake


Order = Look | Start | Stop


class Accepted(Struct, frozen=True, tag=True):
    """It will be done."""

    board: str  # what the valves hang on


class Refused(Struct, frozen=True, tag=True):
    """It will not be done."""

    reason: str


class Ready(Struct, frozen=True, tag=True):
    """How a vehicle is that wants to be armed; what only the host knows is left at its default."""

    readiness: Readiness
    config: str  # see `config_id`


Answer = Accepted | Ready | Refused


class Lease(Struct, frozen=True):
    """Go on flying, until the envelope's valid-until; and what a vehicle must know of the host."""

    may_fire: bool = True  # the supervisor's word; once it is not: come to rest
    fleet: str = ""  # a fault of another vehicle that stops all
    config: str = ""  # see `config_id`
    disk_free: float = 1e12  # where the log goes [bytes]
    at_once: bool = False  # valves and air, without a brake: the operator has said stop twice


def config_id(experiment: Struct) -> str:
    """Tells one experiment from another: host and vehicles must have the same.

    As it is after a journey: a whole number for a real one comes out as a real one.
    """
    text = msgspec.json.encode(experiment)
    arrived = msgspec.json.encode(msgspec.json.decode(text, type=type(experiment)))
    return sha256(arrived).hexdigest()[:16]


class Pace(Struct, frozen=True, gc=False):
    """How a tick kept its time, and how its wires are."""

    late_s: float  # the tick began so long after it was due
    # of the newest plan that has gone out: newest pose's arrival to its first frame
    pose_to_valve_s: float | None
    setpoint_delay_s: float | None = None  # of the newest, from issue to arrival; None: none yet
    setpoints_heard: int = 0  # so far
    setpoints_lost: int = 0  # so far, by their numbers
    refused: int = 0  # messages that were late, expired, foreign, ..., so far
    round_trip_s: float | None = None  # of the newest question to the host
    cameras: str = ""  # what is wrong with this vehicle's body, see `mocap.watch`
    frames_lost: int = 0  # of the cameras, so far


class Flown(Struct, frozen=True, gc=False):
    """One tick of a vehicle, for the log."""

    k: int
    tick: Tick
    pace: Pace
    edges: tuple[tuple[float, int], ...] = ()  # of the valves, as the board reports: t [s], mask


class Counts(Struct, frozen=True):
    """What became of messages and frames, on one vehicle, by the end."""

    commands: dict[str, int]  # setpoints, by `envelope.Verdict`
    refusals: dict[str, int]  # plans, by the board's own word; not_sent: by the gate at the port
    mocap: dict[str, int]  # troubles of its body, by `watch.Trouble`
    lost_frames: int
    reconnects: int  # of the serial line
    mocap_latency_ms: float | None  # median, exposure to arrival
    clock_offset_ms: float | None  # host's clock minus own


class Ended(Struct, frozen=True):
    """A vehicle's flight is over."""

    t: float  # [s]
    fault: str | None
    counts: Counts
    rows: dict[str, float] = {}  # of the fault table that held at any time, and since when [s]
    responses: dict[str, float] = {}  # that were in force, and since when [s]
    landed_s: float | None = None  # from the end until its air was ordered off; None: never [s]
    air: Literal["off", "on"] = "on"  # of its bearings, as the board reported it last
