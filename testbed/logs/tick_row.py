"""Rows of the log from a tick's structs, exact to the last bit; `row_reader.py` is the way back.

A row holds numbers. A text, such as a law's exception, is an `Event` of the same vehicle, written
before the first row that has its code; a name is a number in `Names`, written when it is new.
"""

import struct
from bisect import bisect_left
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, TypeVar

import msgspec
from msgspec import Struct

from testbed.core.codes import FaultReport, Hazard, InhibitReason, Intervention
from testbed.core.records import cdr
from testbed.core.records.kinds import Active, EventKind, FaultCode, SetpointKind
from testbed.core.rows import PoseSamples, References
from testbed.core.types import (
    Demand,
    HostTick,
    LawMessage,
    Reference,
    Setpoint,
    State,
    Stick,
    Tick,
)
from testbed.logs.packing import Packer, elements, getter, several

NAN = float("nan")
S = TypeVar("S")
MOST_KEPT = 1000  # values whose bytes are kept
REPEAT_S = 30.0  # names are repeated: a log may lose its beginning
MOST_FAULTS = 64  # bits of `faults`; later rows of the fault table are not in it


_state, _reference, _demand = getter("State"), getter("Reference"), getter("Demand")
_wrench, _health = getter("Wrench"), getter("Health")
_NO_STATE, _NO_REFERENCE, _NO_DEMAND = (NAN,) * 11 + (0,), (NAN,) * 10, (NAN,) * 7
_STATE, _VEHICLE = several("State", 1), struct.Struct("<II")
_NO_FILTER = (0.0, 0.0, 0, 0)


class Made(NamedTuple):
    """A message for the log."""

    topic: str
    kind: str
    data: bytes


class Names(Struct):
    """Names that rows refer to by number."""

    vehicles: list[str] = []
    obstacles: list[str] = []
    faults: list[str] = []

    def number(self, of: list[str], name: str) -> int:
        """The number of a name, which is appended if it is new."""
        try:
            return of.index(name)
        except ValueError:
            of.append(name)
        return len(of) - 1


class RowWriter:
    """Makes the messages of a log from structs."""

    def __init__(self, names: Names | None = None) -> None:
        self.names = names or Names()
        self._said = (-1, -1, -1)  # sizes of the names in the log
        self._again = 0.0  # when to write them again [s]
        self._packers: dict[str, Packer] = {}
        self._texts: dict[tuple[str, int], Any] = {}  # newest event by topic and kind
        self._bytes: dict[int, tuple[object, bytes]] = {}  # of values, by their identity

    def rows(self, topic: str, t: float, message: Struct) -> list[Made]:
        """The messages for a struct: its row, after what its row refers to."""
        who, _, _ = topic.rpartition("/")
        out: list[Made] = []
        match message:
            case Tick():
                made = self._tick(topic, t, message, who, out)
            case HostTick():
                made = self._host(topic, t, message, who, out)
            case _:
                make = PLAIN[type(message).__name__]
                name, fixed, sequences = make(self, t, message, who, out)
                if name == "Event":
                    return [Made(topic, name, fixed)]
                made = Made(topic, name, self.packer(topic, name).pack(fixed, sequences))
        return [*self.new_names(t), *out, made]

    def before(self, topic: str, t: float, fault: FaultReport | None) -> list[Made]:
        """What a tick's row refers to and is not in the log yet, for a tick without other texts."""
        out = self.new_names(t)
        self.event(EventKind.FAULT, fault, topic.rpartition("/")[0], t, out)
        return out

    def new_names(self, t: float) -> list[Made]:
        """The names, if there are new ones, or if they were written long ago."""
        sizes = len(self.names.vehicles), len(self.names.obstacles), len(self.names.faults)
        if sizes == self._said and t < self._again:
            return []
        self._said, self._again = sizes, t + REPEAT_S
        known = {"t": t, **msgspec.structs.asdict(self.names)}
        return [Made("/names", "Names", cdr.encode("Names", known))]

    def new_names_in(self, times: Sequence[float]) -> dict[float, list[Made]]:
        """`new_names` of ticks at these times, in order [s]; only where there are some."""
        found, k = {}, 0
        while k < len(times):
            if made := self.new_names(times[k]):
                found[times[k]] = made
            k = bisect_left(times, self._again, k + 1)
        return found

    def packer(self, topic: str, name: str) -> Packer:
        """Packs the messages of a topic; it knows their capacities."""
        if topic not in self._packers:
            self._packers[topic] = Packer(name)
        return self._packers[topic]

    def event(
        self, kind: EventKind, what: str | FaultReport | None, who: str, t: float, out: list[Made]
    ) -> bool:
        """Whether there is such a text; a new one becomes an event before the row."""
        if not what:
            return False
        if self._texts.get((who, kind)) != what:
            self._texts[who, kind] = what
            out.append(Made(f"{who}/event", "Event", event_of(t, kind, what)))
        return True

    def _tick(self, topic: str, t: float, tick: Tick, who: str, out: list[Made]) -> Made:
        i, o = tick.inputs, tick.outputs
        v, c, own = i.vitals, o.command, o.message
        event = self.event
        law_error = event(EventKind.LAW_ERROR, v.law_error, who, t, out)
        fleet = event(EventKind.FLEET, v.fleet, who, t, out)
        event(EventKind.FAULT, o.fault, who, t, out)
        aim, references = self._aim(i.setpoint)
        at, now = o.active_setpoint, Active.NONE
        reference, demand = _NO_REFERENCE, _NO_DEMAND
        if isinstance(at, Reference):
            now, reference = Active.REFERENCE, _reference(at)
        elif at is not None:
            now, demand = Active.DEMAND, _demand(at)
        shut = o.inhibit_reason
        values = () if shut is None else shut.values
        heard, heard_values = self._heard(i.messages)
        fixed = (
            i.t, *aim, *_health(i.health), v.operator_age, v.clock_offset, v.late_s, v.disk_free,
            v.foreign, v.session_ok, v.same_config, law_error, fleet, i.armed, v.end,
            o.t, *(_NO_STATE if o.state is None else _state(o.state)), *reference, *demand,
            *_wrench(o.commanded_wrench), *_wrench(o.realised_wrench), *self.filtered(o.filtered),
            c.issued_at, c.valid_until, NAN if own is None else own.t,
            *values, *(NAN,) * (3 - len(values)), value_of(o.fault), self.held(o.faults),
            c.seq, self.fault_code(o.fault), 0 if shut is None else shut.code, len(values),
            o.response, o.state is not None, now, o.air_off, own is not None,
        )  # fmt: skip
        sequences = (
            (len(i.samples), PoseSamples.of(i.samples).rows.tobytes()),
            self._neighbours(i.neighbours),
            references,
            elements("Pulse", zip(c.on_us, c.offset_us, strict=True)),
            heard, heard_values,
            _message(own),
        )  # fmt: skip
        return Made(topic, "Tick", self.packer(topic, "Tick").pack(fixed, sequences))

    def _host(self, topic: str, t: float, tick: HostTick, who: str, out: list[Made]) -> Made:
        i, o = tick.inputs, tick.outputs
        fault = self.event(EventKind.LAW_FAULT, o.fault, who, t, out)
        self._stick(i.stick, who, t, out)
        aim, references = self._aim(o.setpoint)
        own = o.message
        fixed = (
            i.t, *(_NO_STATE if i.own is None else _state(i.own)), i.own is not None,
            o.t, *aim, *self.filtered(o.filtered), NAN if own is None else own.t,
            fault, own is not None,
        )  # fmt: skip
        sequences = (
            self._neighbours(i.neighbours), references, *self._heard(i.messages), _message(own),
        )  # fmt: skip
        return Made(topic, "HostTick", self.packer(topic, "HostTick").pack(fixed, sequences))

    def _stick(self, stick: Stick | None, who: str, t: float, out: list[Made]) -> None:
        """An event when the stick has moved; without one it is where it was."""
        if self._texts.get((who, EventKind.STICK)) != stick:
            self._texts[who, EventKind.STICK] = stick
            found = {"t": t, "kind": EventKind.STICK, "text": "law flies", "parts": ""}
            if stick is not None:
                found |= {"text": "flown by hand", "parts": msgspec.json.encode(stick).decode()}
            out.append(Made(f"{who}/event", "Event", cdr.encode("Event", found)))

    def held(self, faults: Iterable[str]) -> int:
        """Rows of the fault table as bits."""
        rows = {self.names.number(self.names.faults, one) for one in faults}
        return sum(1 << k for k in rows if k < MOST_FAULTS)

    def filtered(self, filtered: Intervention | None) -> tuple[float, float, int, int]:
        """An intervention as numbers."""
        if filtered is None:
            return _NO_FILTER
        names = self.names
        of = names.vehicles if filtered.hazard == Hazard.VEHICLE else names.obstacles
        subject = names.number(of, filtered.name) + 1 if filtered.name else 0
        return filtered.dfx_w, filtered.dfy_w, subject, filtered.hazard

    def fault_code(self, fault: FaultReport | None) -> int:
        """The code of a fault, see kinds.FaultCode."""
        if fault is None:
            return FaultCode.NONE
        if fault.detector:
            return min(self.names.number(self.names.faults, fault.id) + 1, FaultCode.GATE - 1)
        return FaultCode.GATE if fault.id.upper() in InhibitReason.__members__ else FaultCode.OTHER

    def _neighbours(self, states: dict[str, State]) -> tuple[int, bytes]:
        names = self.names
        return len(states), b"".join(
            self._kept(one, _state_bytes) + _VEHICLE.pack(names.number(names.vehicles, name), 0)
            for name, one in states.items()
        )

    def _kept(self, thing: S, make: Callable[[S], bytes]) -> bytes:
        """The bytes of a value that never changes and that several rows have."""
        found = self._bytes.get(id(thing))
        if found is not None and found[0] is thing:
            return found[1]
        if len(self._bytes) > MOST_KEPT:
            self._bytes.clear()
        self._bytes[id(thing)] = thing, (data := make(thing))
        return data

    def _heard(self, messages: dict[str, LawMessage]) -> tuple[Any, Any]:
        if not messages:
            return _EMPTY, _EMPTY
        names = self.names
        heads = (
            (one.t, names.number(names.vehicles, name), len(one.values))
            for name, one in messages.items()
        )
        values = ((value,) for one in messages.values() for value in one.values)
        return elements("Heard", heads), elements("float64", values)

    def _aim(self, setpoint: Setpoint | None) -> tuple[tuple[Any, ...], tuple[int, bytes]]:
        if setpoint is None:
            return (*_NO_DEMAND, NAN, SetpointKind.NONE), _EMPTY
        if isinstance(setpoint, Demand):
            return (*_demand(setpoint), NAN, SetpointKind.DEMAND), _EMPTY
        ahead = setpoint.references
        fixed = (*_NO_DEMAND, setpoint.valid_until, SetpointKind.TRAJECTORY)
        return fixed, (len(ahead), References.of(ahead).rows.tobytes())


_EMPTY = 0, b""


def _state_bytes(state: State) -> bytes:
    return _STATE.pack(*_state(state))


def _message(message: LawMessage | None) -> tuple[int, bytes]:
    return _EMPTY if message is None else elements("float64", ((v,) for v in message.values))


def _json(fault: FaultReport) -> str:
    """A fault as JSON; half a character in the words of an exception is spelled."""
    try:
        return msgspec.json.encode(fault).decode()
    except UnicodeEncodeError:
        text = fault.text.encode(errors="backslashreplace").decode()
        return msgspec.json.encode(FaultReport(fault.id, text, fault.vehicle)).decode()


def event_of(t: float, kind: EventKind, what: str | FaultReport) -> bytes:
    """An event for a text or a fault."""
    found: cdr.Message = {"t": t, "kind": kind, "text": what}
    if isinstance(what, FaultReport):
        found |= {"id": what.id, "text": what.words, "parts": _json(what)}
    return cdr.encode("Event", found)


def _motions(writer: RowWriter, t: float, truth: Any, who: str, out: list[Made]) -> Any:
    writer.names.vehicles += [n for n in truth.vehicles if n not in writer.names.vehicles]
    rows = [(m.x, m.y, m.theta, m.vx, m.vy, m.omega) for m in truth.vehicles.values()]
    return "Truth", (t,), [elements("Motion", rows)]


def _pace(writer: RowWriter, t: float, pace: Any, who: str, out: list[Made]) -> Any:
    known = (pace.pose_to_valve_s, pace.setpoint_delay_s, pace.round_trip_s)
    times = (NAN if one is None else one for one in known)
    cameras = writer.event(EventKind.CAMERAS, pace.cameras, who, t, out)
    counts = pace.setpoints_heard, pace.setpoints_lost, pace.refused, pace.frames_lost
    return "Pace", (t, pace.late_s, *times, *counts, cameras), ()


def _formation(writer: RowWriter, t: float, one: Any, who: str, out: list[Made]) -> Any:
    inner = NAN if one.inner is None else one.inner
    uniformity = NAN if one.uniformity is None else one.uniformity
    return "Formation", (t, *one.p, *one.v, one.outer, inner, uniformity, one.count), ()


def _phase(writer: RowWriter, t: float, one: Any, who: str, out: list[Made]) -> Any:
    parts = "" if one.fault is None else _json(one.fault)
    found = {"t": one.t, "kind": EventKind.PHASE, "id": one.phase, "text": one.because}
    return "Event", cdr.encode("Event", found | {"parts": parts}), ()


PLAIN: dict[str, Callable[..., Any]] = {  # by name of the struct
    "Truth": _motions, "Pace": _pace, "Characterisation": _formation, "Event": _phase,
    "Valves": lambda writer, t, one, *_: ("Valves", (one.t, one.mask), ()),
    "Loop": lambda writer, t, one, *_: ("Loop", (one.t, one.late_s, one.busy_s), ()),
}  # fmt: skip


def value_of(fault: FaultReport | None) -> float:
    """The number of a fault's detector; NaN if it has none."""
    return NAN if fault is None or fault.value is None else fault.value
