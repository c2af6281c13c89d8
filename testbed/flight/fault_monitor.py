"""Evaluates the fault table on one vehicle, tick by tick.

Pure: detector numbers in, response out. Without a fault a tick costs one comparison per row.
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from testbed.core.codes import Detector, FaultReport, Response
from testbed.flight.faults import FaultTable


class Verdict(NamedTuple):
    """Result of a tick."""

    response: Response  # the most severe active one
    holding: tuple[str, ...]  # ids of all rows that hold now
    fault: FaultReport | None  # the latched fault, the first of the most severe


QUIET = Verdict(Response.NONE, (), None)


class Explains(Protocol):
    """What a detector's number means; asked only when a fault is latched."""

    fleet: FaultReport | None  # fault of another vehicle

    def said(self, detector: Detector) -> str:
        """Text for the detector's number, if it has one."""
        ...


class FaultMonitor:
    """One vehicle's fault table with its counters and latches."""

    def __init__(self, table: FaultTable) -> None:
        self._table = table
        self._rows = [(name, row.measures, row) for name, row in table.items()]
        inf = float("inf")
        self._bounds = [
            (k, -inf if row.below is None else row.below, inf if row.above is None else row.above)
            for _, k, row in self._rows
        ]
        self._counts: dict[str, tuple[int, float]] = {}  # ticks in a row, and since when [s]
        self._latched: dict[str, FaultReport] = {}  # by id, in order of appearance
        self._severity = {name: row.code for name, row in table.items()}
        self._verdict = QUIET

    def look(self, t: float, armed: bool, numbers: Sequence[float], explains: Explains) -> Verdict:
        """Judge a tick.

        Args:
            t: now [s].
            armed: faults of a disarmed vehicle are not latched.
            numbers: of the detectors, in the order of `codes.Detector`.
            explains: gives the text for a detector's number.
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
                    fleet = explains.fleet if k == Detector.FLEET else None
                    cause = None if fleet is None else fleet.origin
                    self._latched[name] = row.report(name, numbers[k], explains.said(k), cause)
        self._counts = counts
        severity = self._severity
        response = max(
            (severity[name] for name in (*self._latched, *holding)), default=Response.NONE
        )
        worst = max(self._latched, key=severity.__getitem__, default=None)
        fault = None if worst is None else self._latched[worst]
        self._verdict = Verdict(response, tuple(holding), fault)
        return self._verdict

    @property
    def latched(self) -> tuple[str, ...]:
        """Ids of the latched faults, in order of appearance."""
        return tuple(self._latched)

    def reset(self) -> None:
        """Clear latched faults; a row that still holds latches again at the next tick."""
        self._latched, self._counts, self._verdict = {}, {}, QUIET
