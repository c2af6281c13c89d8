"""Messages between host and vehicles besides states and setpoints."""

from hashlib import sha256
from typing import Literal

import msgspec
from msgspec import Struct

from testbed.core.codes import FaultReport, Response
from testbed.core.jets import JetHealth
from testbed.core.types import Tick
from testbed.core.warned import Warned
from testbed.flight.arming import Readiness


class Look(Struct, frozen=True, tag=True):
    """Report readiness for arming. Answered by `Ready` or `Refused`."""


class Start(Struct, frozen=True, tag=True):
    """Start the flight. Answered by `Accepted` or `Refused`."""

    session: int
    epoch_ns: int  # the run's time 0 on the host's monotonic clock
    ticket: int  # the vehicle gave it to its host, see `roll_call`


class Stop(Struct, frozen=True, tag=True):
    """End the flight: come to rest, then turn the bearing air off."""

    reason: str
    at_once: bool = False  # shut valves and air without braking


class Retune(Struct, frozen=True, tag=True):
    """Fly on with other gains. Answered by `Accepted` or `Refused`."""

    session: int  # of the flight
    at_s: float  # from the tick at this time of the run on
    values: dict[str, float]  # parameters of the law; empty: the change for `at_s` is withdrawn


Order = Look | Start | Stop | Retune


class Accepted(Struct, frozen=True, tag=True):
    """The vehicle carries the order out."""

    board: str  # name of the board that drives the valves


class Refused(Struct, frozen=True, tag=True):
    """The vehicle does not carry the order out."""

    reason: str


class Ready(Struct, frozen=True, tag=True):
    """A vehicle's readiness for arming; fields that only the host knows keep their defaults."""

    readiness: Readiness
    config: str  # see `config_id`
    board: str = ""  # name of the board that drives the valves


Answer = Accepted | Ready | Refused


class Lease(Struct, frozen=True):
    """Permission to fly until the envelope's valid-until, with host data for the vehicle."""

    may_fire: bool = True  # by the supervisor; when it becomes false: come to rest
    fleet: FaultReport | None = None  # fault of another vehicle that stops all vehicles
    config: str = ""  # see `config_id`
    disk_free: float = 1e12  # on the disk of the log [bytes]
    at_once: bool = False  # shut valves and air without braking: the operator stopped twice


def config_id(experiment: Struct) -> str:
    """Identifier of an experiment: host and vehicles must have the same one.

    It is computed after one round trip through the encoding, which turns integers in real-valued
    fields into floats.
    """
    text = msgspec.json.encode(experiment)
    arrived = msgspec.json.encode(msgspec.json.decode(text, type=type(experiment)))
    return sha256(arrived).hexdigest()[:16]


class Pace(Struct, frozen=True, gc=False):
    """Timing of one tick, and the state of its connections."""

    late_s: float  # delay of the tick's start
    # newest plan sent: time from the arrival of its newest pose to its first frame
    pose_to_valve_s: float | None
    setpoint_delay_s: float | None = None  # newest one, from issue to arrival; None: none yet
    setpoints_heard: int = 0  # so far
    setpoints_lost: int = 0  # so far, from gaps in their sequence numbers
    refused: int = 0  # messages that were late, expired, foreign etc., so far
    round_trip_s: float | None = None  # of the newest query to the host
    cameras: str = ""  # fault of this vehicle's rigid body, see `mocap.poses.PoseTrouble`
    frames_lost: int = 0  # camera frames, so far


class TickReport(Struct, frozen=True, gc=False):
    """One tick of a vehicle, for the log."""

    k: int
    tick: Tick
    pace: Pace
    edges: tuple[tuple[float, int], ...] = ()  # valve edges the board reported: t [s], mask
    stops: int = 0  # the operator's stops that this vehicle has heard
    stop_marks: tuple[bytes, ...] = ()  # of these, see `StopRequests.marks`


class Counts(Struct, frozen=True):
    """Counts of messages and frames on one vehicle, at the end of a flight."""

    commands: dict[str, int]  # setpoints, by `envelope.Acceptance`
    refusals: dict[str, int]  # plans, by the board's reason; not_sent: by the command guard
    mocap: dict[str, int]  # faults of its rigid body, by `mocap.poses.PoseTrouble`
    lost_frames: int
    reconnects: int  # of the serial line
    mocap_latency_ms: float | None  # median, exposure to arrival
    clock_offset_ms: float | None  # host's clock minus own


class Ended(Struct, frozen=True):
    """A vehicle's report at the end of its flight."""

    t: float  # [s]
    fault: FaultReport | None
    counts: Counts
    rows: dict[str, float] = {}  # rows of the fault table that held, and since when [s]
    responses: dict[Response, float] = {}  # fault responses that were active, and since when [s]
    landed_s: float | None = None  # from the end to the order "air off"; None: never [s]
    air: Literal["off", "on"] = "on"  # bearing air, as the board reported it last
    jets: tuple[JetHealth, ...] = ()  # in the vehicle file's order
    warned: dict[str, Warned] = {}  # rows of the fault table that held without ending the flight
