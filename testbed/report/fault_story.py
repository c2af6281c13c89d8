"""A fault in words: whose it is, what it is, and who stops because of it.

A fault of one vehicle stops all, so every vehicle says that it has one. What an operator has to
know first is where it began: the culprit. The others follow.
"""

from collections.abc import Iterable, Mapping
from typing import Literal, NamedTuple

from testbed.logs.feed import SeenTick
from testbed.report.scenario import Scenario

Level = Literal["INFO", "WARN", "ERROR", "CRITICAL"]
SHORT = 44  # letters of a fault in the banner
OVER = ("DISARMED", "STOPPED", "FAULT")  # phases of the supervisor in which nobody flies any more
SUPERVISOR = "supervisor"
STATES = {  # of a response: while valves may open, and afterwards
    "hold": ("holding", "holding"),
    "brake": ("braking", "stopped"),
    "coast": ("drifting", "drifting"),
    "land": ("landing", "landed"),
}
STOPPING_TOO = "stopping with the others"
STOPPING = ("brake", "coast", "land")
RANK: tuple[Level, ...] = ("CRITICAL", "ERROR", "WARN", "INFO")


def follows(scenario: Scenario, fault: str) -> bool:
    """Whether a fault is only that another vehicle has one."""
    row = scenario.faults.get(fault.partition(":")[0])
    return row is not None and row.detector == "fleet"


def short(fault: str) -> str:
    """A fault without its row, its numbers and its reasons, for a banner."""
    row, _, text = fault.partition(": ")
    words = text if text and " " not in row else fault  # the gate's words have no row
    words = words.partition(": ")[0].partition(" (")[0]
    if len(words) > SHORT and "? " in words:
        return words.partition("? ")[0] + "?"
    if len(words) > SHORT:
        return words[:SHORT].rpartition(" ")[0] + " ..."
    return words


def _state(tick: SeenTick) -> str:
    """What became of a vehicle with a fault."""
    out = tick.outputs
    flying, over = STATES.get(out.response, (out.response, out.response or "stopped"))
    return over if out.inhibit_reason else flying


class Trouble:
    """Who has a fault of his own, in the order in which they came, and who follows."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._since: dict[str, float] = {}

    def see(self, newest: Mapping[str, SeenTick]) -> None:
        """The newest tick of each vehicle."""
        for name, tick in newest.items():
            if tick.outputs.fault is not None:
                self._since.setdefault(name, tick.inputs.t)
            else:
                self._since.pop(name, None)

    def culprits(self, newest: Mapping[str, SeenTick]) -> dict[str, str]:
        """Who has a fault of his own, or is said to have one, and which in short words."""
        found: dict[str, str] = {}
        said = ""
        for name in sorted(self._since, key=self._since.__getitem__):
            fault = newest[name].outputs.fault or ""
            if follows(self._scenario, fault):
                said = said or fault
            else:
                found[name] = short(fault)
        if not found and said:
            for name in self._scenario.vehicles:  # a vehicle that is silent, or its law on the host
                before, found_it, words = said.partition(f" {name}: ")
                if found_it and before:
                    return {name: short(words)}
        return found

    def banner(self, newest: Mapping[str, SeenTick]) -> str:
        """The culprit first, then who follows; empty: no fault."""
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
    """One line of what happened."""

    t: float  # [s]
    who: tuple[str, ...]
    level: Level
    words: str


class Story:
    """What vehicles and supervisor say, as lines: each fault's sentence once, the culprit first."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._known: set[str] = set()  # faults whose sentence has been said

    def tell(self, rows: Iterable[tuple[float, str, str]]) -> list[Said]:
        """Lines of (time, who, words); what comes with the next call is of later."""
        ordered = sorted(rows, key=lambda row: row[0])
        for _, _, words in ordered:
            kind, _, fault = words.partition(": ")
            if kind == "fault" and not follows(self._scenario, fault):
                self._known.add(fault)  # "valves shut" comes with it, or before
        lines: dict[tuple[float, Level, str], list[str]] = {}
        for t, who, words in ordered:
            if (line := self._line(t, who, words)) is not None:
                lines.setdefault((t, *line), []).append(who)
        said = [Said(t, tuple(who), level, words) for (t, level, words), who in lines.items()]
        return sorted(said, key=lambda one: (one.t, RANK.index(one.level)))

    def _line(self, t: float, who: str, words: str) -> tuple[Level, str] | None:
        """Level and words; None if it says nothing new."""
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
            self._known.add(rest)  # whose it is, no vehicle has said
            return "CRITICAL", words
        if kind == "valves shut":
            if rest in self._known or follows(self._scenario, rest):
                return "ERROR", "valves shut"
            return ("WARN" if t > 0.0 else "INFO"), words
        if kind in STOPPING:
            asked = [row for row in rest.split(", ") if row and not follows(self._scenario, row)]
            if rest and not asked:
                return None  # it stops with the others, and says so
            return "ERROR", ": ".join(filter(None, (kind, ", ".join(asked))))
        return ("WARN" if kind in ("warn", "hold", "cameras") else "INFO"), words
