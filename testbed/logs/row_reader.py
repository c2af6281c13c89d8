"""A tick's structs from rows of the log, exact to the last bit; see `tick_row.py`."""

from collections.abc import Iterator
from itertools import chain
from typing import Any, TypeVar

import msgspec

from testbed.core.codes import FaultReport, Hazard, InhibitReason, Intervention, Refusal, Response
from testbed.core.records import cdr
from testbed.core.records.definition import MESSAGES
from testbed.core.records.kinds import Active, EventKind, SetpointKind
from testbed.core.rows import PoseSamples, References
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
    Reference,
    Setpoint,
    State,
    Stick,
    Tick,
    Trajectory,
    ValveCommand,
    Vitals,
    Wrench,
)
from testbed.logs.packing import Unpacked, made, unpack
from testbed.logs.tick_row import MOST_FAULTS, Names

LOST = "its text is in a damaged part of the log"
C = TypeVar("C")
_REASONS = {one.value: one for one in InhibitReason}
_RESPONSES = {one.value: one for one in Response}
_HAZARDS = {one.value: one for one in Hazard}


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
        t, demand, until, kind = next(take), made(Demand, take), next(take), next(take)
        health = made(Health, take)
        operator, offset, late, free, foreign, ok, same, law_error, fleet = _some(take, 9)
        armed, end = _some(take, 2)
        vitals = Vitals(
            bool(ok), operator, offset, late, free, bool(same),
            self.text(who, EventKind.LAW_ERROR) if law_error else "",
            self.report(who, EventKind.FLEET) if fleet else None, foreign, bool(end),
        )  # fmt: skip
        inputs = Inputs(
            t, bool(armed), PoseSamples.from_numbers(row.sequences["samples"]),
            self._setpoint(kind, demand, until, row), self._states(row), health,
            self._messages(row), vitals,
        )  # fmt: skip
        out_t, state, reference = next(take), made(State, take), made(Reference, take)
        demand, wanted, got = made(Demand, take), made(Wrench, take), made(Wrench, take)
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
        t, own, known = next(take), made(State, take), next(take)
        out_t, demand, until, kind = next(take), made(Demand, take), next(take), next(take)
        filtered = self._filtered(*_some(take, 4))
        message_t, fault, sends = _some(take, 3)
        return HostTick(
            HostInputs(
                t, own if known else None, self._states(row), self._messages(row), self._stick(who)
            ),
            HostOutputs(
                out_t, self._setpoint(kind, demand, until, row),
                _own(message_t, row) if sends else None,
                self.report(who, EventKind.LAW_FAULT) if fault else None, filtered,
            ),
        )  # fmt: skip

    def _stick(self, who: str) -> Stick | None:
        """Where the stick was moved to last."""
        found = self._events.get((who, EventKind.STICK))
        parts = "" if found is None else found["parts"]
        return msgspec.json.decode(parts, type=Stick) if parts else None

    def _states(self, row: Unpacked) -> dict[str, State]:
        found = {}
        for one in row.sequences["neighbours"]:
            take = iter(one)
            state = made(State, take)
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
        return Trajectory(References.from_numbers(ahead), until)


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


def _own(t: float, row: Unpacked) -> LawMessage:
    return LawMessage(t, tuple(chain.from_iterable(row.sequences["message"])))
