"""A stream of typed messages for viewers, independent of its source.

A viewer needs fewer fields than the log has, and must also open logs of other versions. It reads
only the fields below; fields missing from an older log get a default. When its reader is slow, a
feed may drop all but the newest message of a topic; the flight never waits for a reader.

`LogFeed` follows the log on any rig, during the flight or afterwards. Viewers cost the flight
nothing, and a viewer that starts late still gets everything. A feed from the network would be
another class with the same two members.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple, Protocol

from msgspec import Struct

from testbed.core.codes import FaultReport, Intervention, Refusal, Response
from testbed.core.types import (
    Demand,
    Health,
    Pose,
    Reference,
    State,
    Twist,
    ValveCommand,
    Wrench,
)
from testbed.logs.log_reader import UNREADABLE, LogError, LogReader
from testbed.logs.message import Decoder
from testbed.logs.recorder import Truth

_ZERO = Wrench(0.0, 0.0, 0.0)


class SeenInputs(Struct, frozen=True, gc=False):
    """The part of a vehicle's inputs that viewers use."""

    t: float  # [s]
    armed: bool
    health: Health
    neighbours: dict[str, State] = {}


class SeenOutputs(Struct, frozen=True, gc=False):
    """The part of a vehicle's outputs that viewers use."""

    t: float  # [s]
    state: State | None
    active_setpoint: Reference | Demand | None
    command: ValveCommand
    commanded_wrench: Wrench = _ZERO
    realised_wrench: Wrench = _ZERO
    inhibit_reason: Refusal | None = None
    fault: FaultReport | None = None
    faults: tuple[str, ...] = ()
    response: Response = Response.NONE
    filtered: Intervention | None = None


class SeenTick(Struct, frozen=True, gc=False):
    """The part of a vehicle's tick that viewers use."""

    inputs: SeenInputs
    outputs: SeenOutputs


class SeenHostInputs(Struct, frozen=True, gc=False):
    """The part of the host's inputs that viewers use."""

    t: float  # [s]
    own: State | None
    neighbours: dict[str, State] = {}


class SeenHost(Struct, frozen=True, gc=False):
    """The part of a host law's tick that viewers use."""

    inputs: SeenHostInputs


class Loop(Struct, frozen=True, gc=False):
    """Timing of the flight's loop in real time."""

    t: float  # the tick was due [s]
    late_s: float  # delay of its start [s]
    busy_s: float  # its duration [s]


class SeenPace(Struct, frozen=True, gc=False):
    """The part of a vehicle's `Pace` that viewers use."""

    late_s: float  # delay of its tick's start [s]
    setpoint_delay_s: float | None = None  # of the newest setpoint
    setpoints_heard: int = 0  # so far
    setpoints_lost: int = 0  # so far
    cameras: str = ""  # fault of its rigid body


class SeenValves(Struct, frozen=True, gc=False):
    """Valve outputs that a board reports."""

    t: float  # from then on [s]
    mask: int  # jet 0 is bit 0


class SeenPhase(Struct, frozen=True, gc=False):
    """A phase change of the supervisor."""

    t: float  # [s]
    phase: str
    because: str = ""
    fault: FaultReport | None = None


Message = SeenTick | SeenHost | Truth | Loop | SeenPace | SeenValves | SeenPhase


class News(NamedTuple):
    """One message."""

    topic: str
    who: str  # the vehicle; empty: all vehicles
    t: float  # [s]
    message: Message


class Feed(Protocol):
    """Source of messages for viewers."""

    @property
    def ended(self) -> bool:
        """Whether no more messages will come."""
        ...

    def news(self) -> Iterator[News]:
        """Messages since the last call, without waiting; in order of time within a topic."""
        ...


_KINDS: dict[str, type[Struct]] = {
    "Tick": SeenTick, "HostTick": SeenHost, "Truth": Truth, "Loop": Loop,
    "Pace": SeenPace, "Valves": SeenValves, "Event": SeenPhase,
}  # fmt: skip


class LogFeed:
    """A `Feed` that follows a log."""

    def __init__(self, book: LogReader) -> None:
        self._book = book
        self._decoders = {name: Decoder(kind) for name, kind in _KINDS.items()}

    @property
    def ended(self) -> bool:
        """See `Feed`."""
        return self._book.finished

    def news(self) -> Iterator[News]:
        """See `Feed`; starts at the beginning of the log."""
        for topic, stamp, data in self._book.read():
            decoder = self._decoders.get(self._book.kinds.get(topic, ""))
            if decoder is None:
                continue
            try:
                message: Any = decoder.decode(data)
            except UNREADABLE as error:
                raise LogError(f"{topic} at {stamp * 1e-9:.3f} s: {error}") from None
            yield News(topic, topic.removeprefix("/").split("/")[0], stamp * 1e-9, message)


def pose_of(active_setpoint: Reference | Demand | None) -> Pose | None:
    """The commanded pose of a vehicle; None if a force was commanded."""
    return active_setpoint.pose if isinstance(active_setpoint, Reference) else None


def stopping_point(state: State, decel: float) -> tuple[float, float]:
    """Where a vehicle comes to rest if it brakes now [m]."""
    twist: Twist = state.twist
    speed = (twist.vx**2 + twist.vy**2) ** 0.5
    return (
        state.pose.x + twist.vx * speed / (2.0 * decel),
        state.pose.y + twist.vy * speed / (2.0 * decel),
    )
