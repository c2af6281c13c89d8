"""Describes a fault for the operator: its origin, its cause, and the vehicles that stop with it.

A fault of one vehicle stops all vehicles, so every vehicle reports one. The operator must first
know its origin, the culprit; the other vehicles follow.
"""

from collections.abc import Iterable, Mapping
from typing import Literal, NamedTuple

from testbed.config.experiment import Experiment
from testbed.core.codes import Detector, FaultCause, Response
from testbed.core.types import Tick
from testbed.logs.history import FlightEvent

Level = Literal["INFO", "WARN", "ERROR", "CRITICAL"]
OVER = ("DISARMED", "STOPPED", "FAULT")  # phases of the supervisor after the flight
SUPERVISOR = "supervisor"
STATES = {  # by response: text while valves may open, and afterwards
    Response.NONE: ("", "stopped"),
    Response.WARN: ("warn", "warn"),
    Response.HOLD: ("holding", "holding"),
    Response.BRAKE: ("braking", "stopped"),
    Response.COAST: ("drifting", "drifting"),
    Response.LAND: ("landing", "landed"),
}
STOPPING_TOO = "stopping with the others"
STOPPING = tuple(one.words for one in Response if one >= Response.BRAKE)
RANK: tuple[Level, ...] = ("CRITICAL", "ERROR", "WARN", "INFO")


def _state(tick: Tick) -> str:
    """State of a vehicle with a fault, for the banner."""
    out = tick.outputs
    flying, over = STATES[out.response]
    return over if out.inhibit_reason else flying


class FaultyVehicles:
    """Vehicles with faults, in order of time, and which of these faults are their own."""

    def __init__(self, scenario: Experiment) -> None:
        self._scenario = scenario
        self._since: dict[str, float] = {}

    def see(self, newest: Mapping[str, Tick]) -> None:
        """Update with the newest tick of each vehicle."""
        for name, tick in newest.items():
            if tick.outputs.fault is not None:
                self._since.setdefault(name, tick.inputs.t)
            else:
                self._since.pop(name, None)

    def culprits(self, newest: Mapping[str, Tick]) -> dict[str, str]:
        """Vehicles with a fault of their own, also as reported by others, and its title."""
        found: dict[str, str] = {}
        cause: FaultCause | None = None
        for name in sorted(self._since, key=self._since.__getitem__):
            fault = newest[name].outputs.fault
            if fault is not None and fault.cause is not None:
                cause = cause or fault.cause
            elif fault is not None:
                found[name] = fault.title
        if not found and cause is not None and cause.vehicle in self._scenario.vehicles:
            return {cause.vehicle: cause.title}  # a silent vehicle, or its law on the host
        return found

    def banner(self, newest: Mapping[str, Tick]) -> str:
        """Text of the banner, the culprit first, then the others; empty: no fault."""
        culprits = self.culprits(newest)
        if not self._since:
            return ""
        pieces = []
        for name, words in culprits.items():
            tick = newest.get(name)
            state = _state(tick) if tick is not None and tick.outputs.fault else "silent"
            pieces.append(f"{name}: {words} - {state}")
        others: dict[str, list[str]] = {}
        for name in self._since:
            if name not in culprits:
                others.setdefault(_state(newest[name]), []).append(name)
        pieces += [f"{', '.join(who)} {words} too" for words, who in others.items()]
        return "FAULT " + "   |   ".join(pieces)


class EventLine(NamedTuple):
    """One line of the list of events."""

    t: float  # [s]
    who: tuple[str, ...]
    level: Level
    words: str


class Story:
    """Converts events of vehicles and supervisor to lines: each fault once, the culprit first."""

    def __init__(self, scenario: Experiment) -> None:
        self._scenario = scenario
        self._known: set[tuple[str, str, str]] = set()  # faults already reported, by `_key`

    def lines_of(self, rows: Iterable[tuple[str, FlightEvent]]) -> list[EventLine]:
        """Lines of rows (who, what); each call must be later than the previous one."""
        ordered = sorted(rows, key=lambda row: row[1].t)
        for who, one in ordered:
            if one.kind == "fault" and one.fault is not None and one.fault.cause is None:
                self._known.add(_key(who, one.fault))  # "valves shut" arrives with it, or before
        lines: dict[tuple[float, Level, str], list[str]] = {}
        for who, one in ordered:
            if (line := self._line(who, one)) is not None:
                lines.setdefault((one.t, *line), []).append(who)
        found = [EventLine(t, tuple(who), level, words) for (t, level, words), who in lines.items()]
        return sorted(found, key=lambda one: (one.t, RANK.index(one.level)))

    def _line(self, who: str, one: FlightEvent) -> tuple[Level, str] | None:
        """Level and text of a line; None if it repeats known information."""
        kind, fault = one.kind, one.fault
        if who == SUPERVISOR:
            if fault is None and (kind, one.words) == ("STOPPED", "stop"):
                return "WARN", "stopped by the operator"
            if fault is None:
                return ("CRITICAL" if kind == "FAULT" else "INFO"), one.text
            known = _key("", fault) in self._known
            return "CRITICAL", f"FAULT: {fault.vehicle}" if known else one.text
        if kind == "fault" and fault is not None:
            if fault.cause is None:
                return "CRITICAL", one.text
            if _key("", fault.cause) in self._known:
                return "ERROR", STOPPING_TOO
            self._known.add(_key("", fault.cause))  # no vehicle has reported it as its own
            return "CRITICAL", one.text
        if kind == "valves shut":
            if not one.words:  # by a fault, which has a line of its own
                return "ERROR", one.text
            return ("WARN" if one.t > 0.0 else "INFO"), one.text
        if kind in STOPPING:
            asked = [row for row in one.rows if not self._follows(row)]
            if one.rows and not asked:
                return None  # its fault line already reports that it stops with the others
            return "ERROR", ": ".join(filter(None, (kind, ", ".join(asked))))
        return ("WARN" if kind in ("warn", "hold", "cameras") else "INFO"), one.text

    def _follows(self, name: str) -> bool:
        """Whether a row of the fault table only reports the fault of another vehicle."""
        row = self._scenario.faults.get(name)
        return row is not None and row.measures == Detector.FLEET


def _key(who: str, fault: FaultCause) -> tuple[str, str, str]:
    return fault.vehicle or who, fault.id, fault.text
