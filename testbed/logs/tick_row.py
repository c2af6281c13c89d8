"""Rows of the log from a tick's structs, and structs from rows, exact to the last bit.

A row holds numbers. A text, such as a law's exception, is an `Event` of the same vehicle, written
before the first row that has its code; a name is a number in `Names`, written when it is new.
"""

from collections.abc import Callable, Iterator
from itertools import chain
from typing import Any, NamedTuple, TypeVar

import msgspec
from msgspec import Struct
from msgspec.structs import fields

from testbed.core.codes import FaultReport, Hazard, InhibitReason, Intervention, Refusal, Response
from testbed.core.error import TestbedError
from testbed.core.records import cdr
from testbed.core.records.definition import MESSAGES
from testbed.core.records.kinds import Active, EventKind, FaultCode, SetpointKind
from testbed.core.types import (
    Demand,
    EndingTick,
    Health,
    HostInputs,
    HostOutputs,
    HostTick,
    Inputs,
    LawMessage,
    Outputs,
    PoseSample,
    Reference,
    Setpoint,
    State,
    Tick,
    Trajectory,
    ValveCommand,
    Vitals,
    Wrench,
)  # fmt: skip
from testbed.logs.packing import Packer, Unpacked, getter, unpack

NAN = float("nan")
MOST_FAULTS = 64  # rows of the fault table: bits of `faults`
LOST = "its text is in a damaged part of the log"
S = TypeVar("S", bound=Struct)
C = TypeVar("C")
_REASONS = {one.value: one for one in InhibitReason}
_RESPONSES = {one.value: one for one in Response}
_HAZARDS = {one.value: one for one in Hazard}

_state, _reference, _demand = getter("State"), getter("Reference"), getter("Demand")
_sample, _wrench, _health = getter("PoseSample"), getter("Wrench"), getter("Health")
_NO_STATE, _NO_REFERENCE, _NO_DEMAND = (NAN,) * 11 + (0,), (NAN,) * 10, (NAN,) * 7
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
        if name not in of:
            of.append(name)
        if len(self.faults) > MOST_FAULTS:
            raise TestbedError(f"expected at most {MOST_FAULTS} rows in the fault table")
        return of.index(name)


class RowWriter:
    """Makes the messages of a log from structs."""

    def __init__(self, names: Names | None = None) -> None:
        self.names = names or Names()
        self._said = (-1, -1, -1)  # sizes of the names in the log
        self._packers: dict[str, Packer] = {}
        self._texts: dict[tuple[str, int], Any] = {}  # newest event by topic and kind

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
                made = Made(topic, name, self._packer(topic, name).pack(fixed, sequences))
        sizes = len(self.names.vehicles), len(self.names.obstacles), len(self.names.faults)
        if sizes != self._said:
            self._said = sizes
            known = {"t": t, **msgspec.structs.asdict(self.names)}
            out.insert(0, Made("/names", "Names", cdr.encode("Names", known)))
        return [*out, made]

    def _packer(self, topic: str, name: str) -> Packer:
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
        said = self.event
        law_error = said(EventKind.LAW_ERROR, v.law_error, who, t, out)
        fleet = said(EventKind.FLEET, v.fleet, who, t, out)
        said(EventKind.FAULT, o.fault, who, t, out)
        aim, references = _aim(i.setpoint)
        at, now = o.active_setpoint, Active.NONE
        reference, demand = _NO_REFERENCE, _NO_DEMAND
        if isinstance(at, Reference):
            now, reference = Active.REFERENCE, _reference(at)
        elif at is not None:
            now, demand = Active.DEMAND, _demand(at)
        shut = o.inhibit_reason
        values = () if shut is None else shut.values
        held = sum(1 << self.names.number(self.names.faults, one) for one in o.faults)
        heard, heard_values = self._heard(i.messages)
        fixed = (
            i.t, *aim, *_health(i.health), v.operator_age, v.clock_offset, v.late_s, v.disk_free,
            v.foreign, v.session_ok, v.same_config, law_error, fleet, i.armed, v.end,
            o.t, *(_NO_STATE if o.state is None else _state(o.state)), *reference, *demand,
            *_wrench(o.commanded_wrench), *_wrench(o.realised_wrench), *self._filter(o.filtered),
            c.issued_at, c.valid_until, NAN if own is None else own.t,
            *values, *(NAN,) * (3 - len(values)), _value(o.fault), held,
            c.seq, self._fault(o.fault), 0 if shut is None else shut.code, len(values), o.response,
            o.state is not None, now, o.air_off, own is not None,
        )  # fmt: skip
        sequences = (
            (len(i.samples), _flat(map(_sample, i.samples))),
            self._neighbours(i.neighbours),
            references,
            (len(c.on_us), _flat(zip(c.on_us, c.offset_us, strict=True))),
            heard, heard_values,
            _message(own),
        )  # fmt: skip
        return Made(topic, "Tick", self._packer(topic, "Tick").pack(fixed, sequences))

    def _host(self, topic: str, t: float, tick: HostTick, who: str, out: list[Made]) -> Made:
        i, o = tick.inputs, tick.outputs
        fault = self.event(EventKind.LAW_FAULT, o.fault, who, t, out)
        aim, references = _aim(o.setpoint)
        own = o.message
        fixed = (
            i.t, *(_NO_STATE if i.own is None else _state(i.own)), i.own is not None,
            o.t, *aim, *self._filter(o.filtered), NAN if own is None else own.t,
            fault, own is not None,
        )  # fmt: skip
        sequences = (
            self._neighbours(i.neighbours), references, *self._heard(i.messages), _message(own),
        )  # fmt: skip
        return Made(topic, "HostTick", self._packer(topic, "HostTick").pack(fixed, sequences))

    def _filter(self, filtered: Intervention | None) -> tuple[float, float, int, int]:
        if filtered is None:
            return _NO_FILTER
        names = self.names
        of = names.vehicles if filtered.hazard == Hazard.VEHICLE else names.obstacles
        subject = names.number(of, filtered.name) + 1 if filtered.name else 0
        return filtered.dfx_w, filtered.dfy_w, subject, filtered.hazard

    def _fault(self, fault: FaultReport | None) -> int:
        if fault is None:
            return FaultCode.NONE
        if fault.detector:
            return self.names.number(self.names.faults, fault.id) + 1
        return FaultCode.GATE if fault.id.upper() in InhibitReason.__members__ else FaultCode.OTHER

    def _neighbours(self, states: dict[str, State]) -> tuple[int, list[Any]]:
        names = self.names
        return len(states), _flat(
            (*_state(one), names.number(names.vehicles, name)) for name, one in states.items()
        )

    def _heard(self, messages: dict[str, LawMessage]) -> tuple[Any, Any]:
        names = self.names
        heads = (
            (one.t, names.number(names.vehicles, name), len(one.values))
            for name, one in messages.items()
        )
        values = _flat(one.values for one in messages.values())
        return (len(messages), _flat(heads)), (len(values), values)


def _flat(parts: Any) -> list[Any]:
    return list(chain.from_iterable(parts))


def _aim(setpoint: Setpoint | None) -> tuple[tuple[Any, ...], tuple[int, list[Any]]]:
    if setpoint is None:
        return (*_NO_DEMAND, NAN, SetpointKind.NONE), (0, [])
    if isinstance(setpoint, Demand):
        return (*_demand(setpoint), NAN, SetpointKind.DEMAND), (0, [])
    ahead = setpoint.references
    fixed = (*_NO_DEMAND, setpoint.valid_until, SetpointKind.TRAJECTORY)
    return fixed, (len(ahead), _flat(map(_reference, ahead)))


def _message(message: LawMessage | None) -> tuple[int, tuple[float, ...]]:
    return (0, ()) if message is None else (len(message.values), message.values)


def event_of(t: float, kind: EventKind, what: str | FaultReport) -> bytes:
    """An event for a text or a fault."""
    found: cdr.Message = {"t": t, "kind": kind, "text": what}
    if isinstance(what, FaultReport):
        found |= {"id": what.id, "text": what.words, "parts": msgspec.json.encode(what).decode()}
    return cdr.encode("Event", found)


def _motions(writer: RowWriter, t: float, truth: Any, who: str, out: list[Made]) -> Any:
    writer.names.vehicles += [n for n in truth.vehicles if n not in writer.names.vehicles]
    rows = [(m.x, m.y, m.theta, m.vx, m.vy, m.omega) for m in truth.vehicles.values()]
    return "Truth", (t,), [(len(rows), _flat(rows))]


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
    parts = "" if one.fault is None else msgspec.json.encode(one.fault).decode()
    found = {"t": one.t, "kind": EventKind.PHASE, "id": one.phase, "text": one.because}
    return "Event", cdr.encode("Event", found | {"parts": parts}), ()


PLAIN: dict[str, Callable[..., Any]] = {  # by name of the struct
    "Truth": _motions, "Pace": _pace, "Characterisation": _formation, "Event": _phase,
    "Valves": lambda writer, t, one, *_: ("Valves", (one.t, one.mask), ()),
    "Loop": lambda writer, t, one, *_: ("Loop", (one.t, one.late_s, one.busy_s), ()),
}  # fmt: skip


class RowReader:
    """Makes structs from the messages of a log, in its order."""

    def __init__(self) -> None:
        self.names = Names()
        self._events: dict[tuple[str, int], cdr.Message] = {}  # newest by vehicle and kind

    def learn(self, topic: str, kind: str, data: bytes) -> cdr.Message | None:
        """Keep what later rows refer to; the event, if it is one."""
        if kind == "Names":
            found = cdr.decode(MESSAGES["Names"], data)
            self.names = Names(found["vehicles"], found["obstacles"], found["faults"])
        elif kind == "Event":
            found = cdr.decode(MESSAGES["Event"], data)
            self._events[topic.rpartition("/")[0], found["kind"]] = found
            return found
        return None

    def text(self, who: str, kind: EventKind) -> str:
        """The newest text of a kind."""
        found = self._events.get((who, kind))
        return LOST if found is None else str(found["text"])

    def report(self, who: str, kind: EventKind) -> FaultReport:
        """The newest fault of a kind."""
        found = self._events.get((who, kind))
        return (None if found is None else fault_of(found)) or FaultReport("", LOST)

    def vehicle(self, k: int) -> str:
        """The name of a vehicle."""
        return _name(self.names.vehicles, k)

    def tick(self, topic: str, data: bytes) -> Tick:
        """The tick in a row."""
        row, who = unpack("Tick", data), topic.rpartition("/")[0]
        take = iter(row.fixed)
        t, demand, until, kind = next(take), _made(Demand, take), next(take), next(take)
        health = _made(Health, take)
        operator, offset, late, free, foreign, ok, same, law_error, fleet = _some(take, 9)
        armed, end = _some(take, 2)
        vitals = Vitals(
            bool(ok), operator, offset, late, free, bool(same),
            self.text(who, EventKind.LAW_ERROR) if law_error else "",
            self.report(who, EventKind.FLEET) if fleet else None, foreign, bool(end),
        )  # fmt: skip
        inputs = Inputs(
            t, bool(armed), tuple(PoseSample(*one) for one in row.sequences["samples"]),
            self._setpoint(kind, demand, until, row), self._states(row), health,
            self._messages(row), vitals,
        )  # fmt: skip
        out_t, state, reference = next(take), _made(State, take), _made(Reference, take)
        demand, wanted, got = _made(Demand, take), _made(Wrench, take), _made(Wrench, take)
        filtered = self._filtered(*_some(take, 4))
        issued, until, message_t, *values = _some(take, 6)
        _, held, seq, fault, inhibit, length, response, known, active, air_off, sends = _some(
            take, 11
        )
        aims: dict[int, Reference | Demand] = {Active.REFERENCE: reference, Active.DEMAND: demand}
        pulses = row.sequences["pulses"]
        outputs = Outputs(
            out_t, state if known else None, aims.get(active), wanted, got,
            ValveCommand(
                seq, issued, until, tuple(on for on, _ in pulses), tuple(at for _, at in pulses)
            ),
            Refusal(_meant(_REASONS, inhibit), tuple(values[:length])) if inhibit else None,
            self.report(who, EventKind.FAULT) if fault else None,
            _own(message_t, row) if sends else None,
            tuple(_name(self.names.faults, k) for k in range(MOST_FAULTS) if held >> k & 1),
            _meant(_RESPONSES, response), filtered, bool(air_off),
        )  # fmt: skip
        ending = topic.endswith("/ending")
        return EndingTick(inputs, outputs) if ending else Tick(inputs, outputs)

    def host(self, topic: str, data: bytes) -> HostTick:
        """The tick of a law on the host in a row."""
        row, who = unpack("HostTick", data), topic.rpartition("/")[0]
        take = iter(row.fixed)
        t, own, known = next(take), _made(State, take), next(take)
        out_t, demand, until, kind = next(take), _made(Demand, take), next(take), next(take)
        filtered = self._filtered(*_some(take, 4))
        message_t, fault, sends = _some(take, 3)
        return HostTick(
            HostInputs(t, own if known else None, self._states(row), self._messages(row)),
            HostOutputs(
                out_t, self._setpoint(kind, demand, until, row),
                _own(message_t, row) if sends else None,
                self.report(who, EventKind.LAW_FAULT) if fault else None, filtered,
            ),
        )  # fmt: skip

    def _states(self, row: Unpacked) -> dict[str, State]:
        found = {}
        for one in row.sequences["neighbours"]:
            take = iter(one)
            state = _made(State, take)
            found[self.vehicle(next(take))] = state
        return found

    def _messages(self, row: Unpacked) -> dict[str, LawMessage]:
        values = chain.from_iterable(row.sequences["heard_values"])
        return {
            self.vehicle(k): LawMessage(t, tuple(_some(values, length)))
            for t, k, length in row.sequences["heard"]
        }

    def _filtered(self, dfx: float, dfy: float, subject: int, hazard: int) -> Intervention | None:
        if not hazard:
            return None
        code = _meant(_HAZARDS, hazard)
        of = self.names.vehicles if code == Hazard.VEHICLE else self.names.obstacles
        return Intervention(dfx, dfy, code, _name(of, subject - 1) if subject else "")

    def _setpoint(self, kind: int, demand: Demand, until: float, row: Unpacked) -> Setpoint | None:
        if kind == SetpointKind.DEMAND:
            return demand
        if kind == SetpointKind.NONE:
            return None
        ahead = row.sequences["references"]
        return Trajectory(tuple(_made(Reference, iter(one)) for one in ahead), until)


def fault_of(event: cdr.Message) -> FaultReport | None:
    """The fault in an event."""
    parts = event["parts"]
    return msgspec.json.decode(parts, type=FaultReport) if parts else None


def _name(of: list[str], k: int) -> str:
    return of[k] if k < len(of) else f"#{k}"


def _meant(codes: dict[int, C], code: int) -> C:
    if code not in codes:
        raise ValueError(f"expected one of the codes {sorted(codes)}, found {code}")
    return codes[code]


def _some(take: Iterator[Any], number: int) -> list[Any]:
    return [next(take) for _ in range(number)]


def _value(fault: FaultReport | None) -> float:
    return NAN if fault is None or fault.value is None else fault.value


def _own(t: float, row: Unpacked) -> LawMessage:
    return LawMessage(t, tuple(chain.from_iterable(row.sequences["message"])))


_PARTS: dict[type[Struct], tuple[type[Struct] | None, ...]] = {}


def _made(kind: type[S], take: Iterator[Any]) -> S:
    """A struct from the next numbers."""
    if kind not in _PARTS:
        _PARTS[kind] = tuple(
            one.type if issubclass(one.type, Struct) else None for one in fields(kind)
        )
    parts = (next(take) if one is None else _made(one, take) for one in _PARTS[kind])
    return kind(*parts)
