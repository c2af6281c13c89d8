"""What those who look on are told: a stream of typed messages, wherever it comes from.

A viewer needs less than the log holds, and must open logs of other versions, too. So it reads only
the fields below, and what an older log does not have gets a default. A feed may leave out all but
the newest message of a topic when its reader is slow; the flight never waits for one.

`LogFeed` follows the log of record, on any rig, while it is written or afterwards: the flight does
nothing for those who look on, and who comes late still sees everything. A feed from the network is
one more class with the same two members.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple, Protocol

from msgspec import Struct

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


class SeenFilter(Struct, frozen=True, gc=False):
    """What a safety filter made of a force."""

    dfx_w: float = 0.0  # [N]
    dfy_w: float = 0.0  # [N]
    because: str = ""


class SeenInputs(Struct, frozen=True, gc=False):
    """Of a vehicle's inputs."""

    t: float  # [s]
    armed: bool
    health: Health
    neighbours: dict[str, State] = {}


class SeenOutputs(Struct, frozen=True, gc=False):
    """Of a vehicle's outputs."""

    t: float  # [s]
    state: State | None
    active_setpoint: Reference | Demand | None
    command: ValveCommand
    commanded_wrench: Wrench = _ZERO
    realised_wrench: Wrench = _ZERO
    inhibit_reason: str | None = None
    fault: str | None = None
    faults: tuple[str, ...] = ()
    response: str = ""
    filtered: SeenFilter | None = None


class SeenTick(Struct, frozen=True, gc=False):
    """Of a vehicle's tick."""

    inputs: SeenInputs
    outputs: SeenOutputs


class SeenHostInputs(Struct, frozen=True, gc=False):
    """Of what the host's half knows."""

    t: float  # [s]
    own: State | None
    neighbours: dict[str, State] = {}


class SeenHost(Struct, frozen=True, gc=False):
    """Of a tick of a law on the host."""

    inputs: SeenHostInputs


class Loop(Struct, frozen=True, gc=False):
    """How the flight's loop keeps time, where it flies by the wall clock."""

    t: float  # the tick was due [s]
    late_s: float  # it began so much later [s]
    busy_s: float  # and took so long [s]


class SeenPace(Struct, frozen=True, gc=False):
    """Of a vehicle's wires."""

    late_s: float  # its tick began so much later [s]
    setpoint_delay_s: float | None = None  # of the newest
    setpoints_heard: int = 0  # so far
    setpoints_lost: int = 0  # so far
    cameras: str = ""  # what is wrong with its body


class SeenValves(Struct, frozen=True, gc=False):
    """What a board says of its valves."""

    t: float  # from then on [s]
    mask: int  # jet 0 is bit 0


class SeenPhase(Struct, frozen=True, gc=False):
    """What the supervisor did."""

    t: float  # [s]
    phase: str
    because: str = ""


Message = SeenTick | SeenHost | Truth | Loop | SeenPace | SeenValves | SeenPhase


class News(NamedTuple):
    """One message."""

    topic: str
    who: str  # the vehicle, empty for all
    t: float  # [s]
    message: Message


class Feed(Protocol):
    """Where those who look on get their messages."""

    @property
    def ended(self) -> bool:
        """Whether nothing will come any more."""
        ...

    def news(self) -> Iterator[News]:
        """What has come since the last call, without waiting; of a topic, in order of time."""
        ...


_KINDS: dict[str, type[Struct]] = {
    "Tick": SeenTick, "HostTick": SeenHost, "Truth": Truth, "Loop": Loop,
    "Pace": SeenPace, "Valves": SeenValves, "Event": SeenPhase,
}  # fmt: skip


class LogFeed:
    """Follows a log."""

    def __init__(self, book: LogReader) -> None:
        self._book = book
        self._decoders = {name: Decoder(kind) for name, kind in _KINDS.items()}

    @property
    def ended(self) -> bool:
        """See `Feed`."""
        return self._book.finished

    def news(self) -> Iterator[News]:
        """See `Feed`; everything, also that of before."""
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
    """Where a vehicle was asked to be; None where it was asked for a force."""
    return active_setpoint.pose if isinstance(active_setpoint, Reference) else None


def stopping_point(state: State, decel: float) -> tuple[float, float]:
    """Where a vehicle comes to rest if it brakes now [m]."""
    twist: Twist = state.twist
    speed = (twist.vx**2 + twist.vy**2) ** 0.5
    return (
        state.pose.x + twist.vx * speed / (2.0 * decel),
        state.pose.y + twist.vy * speed / (2.0 * decel),
    )
