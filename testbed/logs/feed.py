"""A stream of typed messages for viewers, independent of its source.

When its reader is slow, a feed may drop all but the newest message of a topic; the flight never
waits for a reader.

`LogFeed` follows the log on any rig, during the flight or afterwards. Viewers cost the flight
nothing, and a viewer that starts late still gets everything. A feed from the network would be
another class with the same two members.
"""

import re
from collections.abc import Iterator
from typing import NamedTuple, Protocol

from msgspec import Struct

from testbed.core.codes import FaultReport
from testbed.core.records.definition import MESSAGES
from testbed.core.records.kinds import EventKind
from testbed.core.records.ros import schema_text
from testbed.core.types import Demand, EndingTick, HostTick, Pose, Reference, State, Tick, Twist
from testbed.logs.log_reader import UNREADABLE, LogError, LogReader
from testbed.logs.packing import unpack
from testbed.logs.row_reader import RowReader, fault_of
from testbed.logs.truth import Motion, Truth


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
    mask: int  # bit 0 is jet 1


class SeenPhase(Struct, frozen=True, gc=False):
    """A phase change of the supervisor."""

    t: float  # [s]
    phase: str
    because: str = ""
    fault: FaultReport | None = None


Message = Tick | HostTick | Truth | Loop | SeenPace | SeenValves | SeenPhase


class News(NamedTuple):
    """One message of the log, decoded."""

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


class TypedRows:
    """Makes typed messages from the rows of a log, in its order."""

    def __init__(self) -> None:
        self.read = RowReader()

    def message(self, topic: str, kind: str, data: bytes) -> Message | None:
        """The message in a row; None: it is for other readers.

        Raises:
            ValueError: it is damaged.
        """
        who = topic.rpartition("/")[0]
        match kind:
            case "Tick":
                return self.read.tick(topic, data)
            case "HostTick":
                return self.read.host(topic, data)
            case "Names" | "Event":
                event = self.read.learn(topic, kind, data)
                if event is None or event["kind"] != EventKind.PHASE:
                    return None
                return SeenPhase(event["t"], event["id"], event["text"], fault_of(event))
            case "Truth":
                row = unpack(kind, data)
                motions = enumerate(row.sequences["vehicles"])
                return Truth(row.fixed[0], {self.read.vehicle(k): Motion(*m) for k, m in motions})
            case "Pace":
                _, late, _, delay, _, heard, lost, _, _, cameras = unpack(kind, data).fixed
                text = self.read.text(who, EventKind.CAMERAS) if cameras else ""
                return SeenPace(late, None if delay != delay else delay, heard, lost, text)
            case "Loop":
                return Loop(*unpack(kind, data).fixed)
            case "Valves":
                return SeenValves(*unpack(kind, data).fixed)
        return None


def same_version(book: LogReader, topic: str) -> None:
    """Refuse a topic whose messages have other fields than those of this version.

    Raises:
        LogError: they have.
    """
    kind, text = book.kinds[topic], book.texts[topic]
    if text and kind in MESSAGES and _layout(text) != _layout(schema_text(kind)):
        raise LogError(
            where=f"{book.path}: {topic}", expected=f"messages {kind} of this version",
            found="another version of them", hint="`testbed export` reads it",
        )  # fmt: skip


def _layout(text: str) -> str:
    """A schema without its constants: a new code does not move a field."""
    return re.sub(r"(?m)^\w+ [A-Z0-9_]+=.*\n", "", text)


class LogFeed:
    """A `Feed` that follows a log."""

    def __init__(self, book: LogReader) -> None:
        self._book, self._rows = book, TypedRows()
        self._known: set[str] = set()  # topics of this version

    @property
    def ended(self) -> bool:
        """See `Feed`."""
        return self._book.finished

    def news(self) -> Iterator[News]:
        """See `Feed`; starts at the beginning of the log."""
        for topic, stamp, data in self._book.read():
            if topic not in self._known:
                same_version(self._book, topic)
                self._known.add(topic)
            try:
                message = self._rows.message(topic, self._book.kinds[topic], data)
            except UNREADABLE as error:
                raise LogError(f"{topic} at {stamp * 1e-9:.3f} s: {error}") from None
            if message is not None and not isinstance(message, EndingTick):
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
