"""Describes a fault for the operator: its origin, its cause, and the vehicles that stop with it.

A fault of one vehicle stops all vehicles, so every vehicle reports one. The operator must first
know its origin, the culprit; the other vehicles follow.
"""

from collections.abc import Iterable, Mapping
from typing import Literal, NamedTuple

from testbed.config.experiment import Experiment
from testbed.logs.feed import SeenTick

Level = Literal["INFO", "WARN", "ERROR", "CRITICAL"]
SHORT = 44  # most letters of a fault in the banner
OVER = ("DISARMED", "STOPPED", "FAULT")  # phases of the supervisor after the flight
SUPERVISOR = "supervisor"
STATES = {  # by response: text while valves may open, and afterwards
    "hold": ("holding", "holding"),
    "brake": ("braking", "stopped"),
    "coast": ("drifting", "drifting"),
    "land": ("landing", "landed"),
}
STOPPING_TOO = "stopping with the others"
STOPPING = ("brake", "coast", "land")
RANK: tuple[Level, ...] = ("CRITICAL", "ERROR", "WARN", "INFO")


def follows(scenario: Experiment, fault: str) -> bool:
    """Whether a fault only reports the fault of another vehicle."""
    row = scenario.faults.get(fault.partition(":")[0])
    return row is not None and row.detector == "fleet"


def short(fault: str) -> str:
    """A fault without its identifier, numbers and reasons, for a banner."""
    row, _, text = fault.partition(": ")
    words = text if text and " " not in row else fault  # the gate's faults have no identifier
    words = words.partition(": ")[0].partition(" (")[0]
    if len(words) > SHORT and "? " in words:
        return words.partition("? ")[0] + "?"
    if len(words) > SHORT:
        return words[:SHORT].rpartition(" ")[0] + " ..."
    return words


def _state(tick: SeenTick) -> str:
    """State of a vehicle with a fault, for the banner."""
    out = tick.outputs
    flying, over = STATES.get(out.response, (out.response, out.response or "stopped"))
    return over if out.inhibit_reason else flying


class Trouble:
    """Vehicles with faults, in order of time, and which of these faults are their own."""

    def __init__(self, scenario: Experiment) -> None:
        self._scenario = scenario
        self._since: dict[str, float] = {}

    def see(self, newest: Mapping[str, SeenTick]) -> None:
        """Update with the newest tick of each vehicle."""
        for name, tick in newest.items():
            if tick.outputs.fault is not None:
                self._since.setdefault(name, tick.inputs.t)
            else:
                self._since.pop(name, None)

    def culprits(self, newest: Mapping[str, SeenTick]) -> dict[str, str]:
        """Vehicles with a fault of their own, also as reported by others, with a short text."""
        found: dict[str, str] = {}
        said = ""
        for name in sorted(self._since, key=self._since.__getitem__):
            fault = newest[name].outputs.fault or ""
            if follows(self._scenario, fault):
                said = said or fault
            else:
                found[name] = short(fault)
        if not found and said:
            for name in self._scenario.vehicles:  # for a silent vehicle, or its law on the host
                before, found_it, words = said.partition(f" {name}: ")
                if found_it and before:
                    return {name: short(words)}
        return found

    def banner(self, newest: Mapping[str, SeenTick]) -> str:
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


class Said(NamedTuple):
    """One line of the list of events."""

    t: float  # [s]
    who: tuple[str, ...]
    level: Level
    words: str


class Story:
    """Converts events of vehicles and supervisor to lines: each fault once, the culprit first."""

    def __init__(self, scenario: Experiment) -> None:
        self._scenario = scenario
        self._known: set[str] = set()  # faults already reported

    def tell(self, rows: Iterable[tuple[float, str, str]]) -> list[Said]:
        """Lines of rows (time, who, words); each call must be later than the previous one."""
        ordered = sorted(rows, key=lambda row: row[0])
        for _, _, words in ordered:
            kind, _, fault = words.partition(": ")
            if kind == "fault" and not follows(self._scenario, fault):
                self._known.add(fault)  # "valves shut" arrives with it, or before
        lines: dict[tuple[float, Level, str], list[str]] = {}
        for t, who, words in ordered:
            if (line := self._line(t, who, words)) is not None:
                lines.setdefault((t, *line), []).append(who)
        said = [Said(t, tuple(who), level, words) for (t, level, words), who in lines.items()]
        return sorted(said, key=lambda one: (one.t, RANK.index(one.level)))

    def _line(self, t: float, who: str, words: str) -> tuple[Level, str] | None:
        """Level and text of a line; None if it repeats known information."""
        kind, _, rest = words.partition(": ")
        if who == SUPERVISOR:
            culprit, _, fault = rest.partition(": ")
            if kind != "FAULT":
                return "INFO", words
            return "CRITICAL", f"FAULT: {culprit}" if fault in self._known else words
        if kind == "fault":
            if not follows(self._scenario, rest):
                return "CRITICAL", words
            if any(fault in rest for fault in self._known):
                return "ERROR", STOPPING_TOO
            self._known.add(rest)  # no vehicle has reported it as its own
            return "CRITICAL", words
        if kind == "valves shut":
            if rest in self._known or follows(self._scenario, rest):
                return "ERROR", "valves shut"
            return ("WARN" if t > 0.0 else "INFO"), words
        if kind in STOPPING:
            asked = [row for row in rest.split(", ") if row and not follows(self._scenario, row)]
            if rest and not asked:
                return None  # its fault line already reports that it stops with the others
            return "ERROR", ": ".join(filter(None, (kind, ", ".join(asked))))
        return ("WARN" if kind in ("warn", "hold", "cameras") else "INFO"), words
