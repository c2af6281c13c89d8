"""Rows of the fault table that hold while the flight goes on, for its result."""

from collections.abc import Callable, Sequence

from numpy.typing import NDArray

from testbed.core.codes import Detector
from testbed.core.warned import Warned
from testbed.flight.faults import Fault

# A healthy flight loses a message now and then, so a warning of these rows is not reported.
ROUTINE = Detector.POSE_AGE, Detector.SETPOINT_AGE, Detector.NEIGHBOUR_AGE


class FaultWarnings:
    """Keeps for each row when it held first, and its words at their clearest."""

    def __init__(self, faults: Sequence[tuple[str, Fault]]) -> None:
        self._rows = [(k, *one) for k, one in enumerate(faults) if is_told(one[1])]
        self.found: dict[str, Warned] = {}

    def look(
        self, t: float, holds: NDArray, numbers: NDArray, detail: Callable[[Detector], str]
    ) -> None:  # fmt: skip
        """Note the rows that hold at a tick.

        Args:
            t: now [s].
            holds: 1 for each row that holds, (rows,).
            numbers: of the detectors, (detectors,).
            detail: text for a detector's number at this tick.
        """
        for k, name, row in self._rows:
            if not holds[k]:
                continue
            number, before = float(numbers[row.measures]), self.found.get(name)
            if before is None or (number > before.number) == (row.above is not None):
                words = row.report(name, number, detail(row.measures), None).text
                self.found[name] = Warned(t if before is None else before.t, number, words)


def is_told(row: Fault) -> bool:
    """Whether a row does not end the flight, and does not hold in healthy flights."""
    if row.latched:
        return False
    return row.response == "hold" or (row.response == "warn" and row.measures not in ROUTINE)
