"""What the parties say to each other besides states and setpoints."""

from msgspec import Struct

from testbed.core.types import Tick


class Start(Struct, frozen=True, tag=True):
    """Fly. Answered by `Accepted` or `Refused`."""

    session: int
    epoch_ns: int  # the run's time 0 on the host's monotonic clock


class Stop(Struct, frozen=True, tag=True):
    """Shut every valve and end the flight."""

    reason: str


Order = Start | Stop


class Accepted(Struct, frozen=True, tag=True):
    """It will be done."""

    board: str  # what the valves hang on


class Refused(Struct, frozen=True, tag=True):
    """It will not be done."""

    reason: str


Answer = Accepted | Refused


class Permit(Struct, frozen=True):
    """Go on flying, until the envelope's valid-until."""


class Pace(Struct, frozen=True, gc=False):
    """How a tick kept its time."""

    late_s: float  # the tick began so long after it was due
    # of the newest plan that has gone out: newest pose's arrival to its first frame
    pose_to_valve_s: float | None


class Flown(Struct, frozen=True, gc=False):
    """One tick of a vehicle, for the log."""

    k: int
    tick: Tick
    pace: Pace


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
