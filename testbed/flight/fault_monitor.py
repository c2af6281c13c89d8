"""Evaluates the fault table on one vehicle, tick by tick.

Pure: detector numbers in, response out. Without a fault a tick costs one comparison per row.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from testbed.flight.faults import DETECTORS, SEVERITY, Fault, FaultTable, most_severe

LONGEST_WORDS = 300  # longest text of a fault [characters]: it is sent over the network


class Verdict(NamedTuple):
    """Result of a tick."""

    response: str  # the most severe active response; empty: none
    holding: tuple[str, ...]  # ids of all rows that hold now
    fault: str | None  # text of the latched fault, the first of the most severe


QUIET = Verdict("", (), None)


class FaultMonitor:
    """One vehicle's fault table with its counters and latches."""

    def __init__(self, table: FaultTable) -> None:
        self._table = table
        self._rows = [(name, DETECTORS.index(row.detector), row) for name, row in table.items()]
        inf = float("inf")
        self._bounds = [
            (k, -inf if row.below is None else row.below, inf if row.above is None else row.above)
            for _, k, row in self._rows
        ]
        self._counts: dict[str, tuple[int, float]] = {}  # ticks in a row, and since when [s]
        self._latched: dict[str, str] = {}  # id and text, in order of appearance
        self._verdict = QUIET

    def look(
        self, t: float, armed: bool, numbers: Sequence[float], said: Mapping[str, str]
    ) -> Verdict:
        """Judge a tick.

        Args:
            t: now [s].
            armed: faults of a disarmed vehicle are not latched.
            numbers: of the detectors, in the order of DETECTORS.
            said: text for a detector's number, if it has one.
        """
        out = [
            row for row, (k, low, high) in enumerate(self._bounds) if not low <= numbers[k] <= high
        ]
        if not out and not self._counts:
            return self._verdict
        counts: dict[str, tuple[int, float]] = {}
        holding: list[str] = []
        for index in out:
            name, k, row = self._rows[index]
            count, since = self._counts.get(name, (0, t))
            counts[name] = count + 1, since
            if count + 1 >= row.misses and t - since >= row.timeout_s:
                holding.append(name)
                if armed and row.latched and name not in self._latched:
                    words = said.get(row.detector, "")[:LONGEST_WORDS]
                    value = float(numbers[k])  # some are integers, which {value:.3} rejects
                    self._latched[name] = f"{name}: " + row.text.format(value=value, said=words)
        self._counts = counts
        in_force = [
            self._table[name].response for name in dict.fromkeys((*self._latched, *holding))
        ]
        self._verdict = Verdict(most_severe(in_force), tuple(holding), self._worst())
        return self._verdict

    def _worst(self) -> str | None:
        """Text of the deciding latched fault: the first of the most severe."""
        if not self._latched:
            return None
        return self._latched[
            max(self._latched, key=lambda name: SEVERITY[self._table[name].response])
        ]

    @property
    def latched(self) -> tuple[str, ...]:
        """Ids of the latched faults, in order of appearance."""
        return tuple(self._latched)

    def reset(self) -> None:
        """Clear latched faults; a row that still holds latches again at the next tick."""
        self._latched, self._counts, self._verdict = {}, {}, QUIET


def row_of(table: FaultTable, fault: str) -> Fault | None:
    """The row that a fault's text belongs to."""
    return table.get(fault.partition(":")[0])
