"""Compares what a board reports of its valves with the plans that it was sent.

On a busy computer a plan is sent late, and the board plays what is left of it. The detectors of
bad jets believe the plan, and a pulse that was cut looks like a weak jet. So a plan that was not
played counts as a late tick, after which they begin anew (`flight/detectors.py`).
"""

from collections import deque
from collections.abc import Sequence

from testbed.core.types import ValveCommand
from testbed.flight.detectors import SPOILT

COUNTS_AS = 1.5 * SPOILT  # of a jet period: such a late tick is not believed, and no overrun yet
OFF_S = 0.002  # a pulse that is longer or shorter by more was not the planned one [s]
REPORTED_S = 0.04  # a pulse that ended so long ago is reported, or was not played [s]
EARLY_S = 0.005  # an edge may seem so early: the board's clock is known that well [s]
JOINED_S = 1e-4  # pulses that are closer are one; plans are in whole microseconds [s]
KEPT = 100  # pulses of a jet that are not compared yet

Span = tuple[float, float]  # opening and closing [s]


class ValveWatch:
    """Compares pulses with plans; times are of the run.

    Args:
        jets: number of jets.
        delay_s: from issuing a plan to its start [s].
        period_s: jet period [s].
    """

    def __init__(self, jets: int, delay_s: float, period_s: float) -> None:
        self._delay_s, self._counts_as_s = delay_s, COUNTS_AS * period_s
        self._planned: list[deque[Span]] = [deque(maxlen=KEPT) for _ in range(jets)]
        self._played: list[deque[Span]] = [deque(maxlen=KEPT) for _ in range(jets)]
        self._opened: list[float | None] = [None] * jets
        self._heard = False

    def plan(self, command: ValveCommand) -> None:
        """Take a plan that was sent."""
        begin = command.issued_at + self._delay_s
        pulses = zip(self._planned, command.on_us, command.offset_us, strict=True)
        for planned, on_us, offset_us in pulses:
            if on_us == 0:
                continue
            up = begin + 1e-6 * offset_us
            down = up + 1e-6 * on_us
            if planned and up - planned[-1][1] < JOINED_S:
                up = planned.pop()[0]
            planned.append((up, down))

    def receive(self, edges: Sequence[tuple[float, int]]) -> None:
        """Take edges that the board has reported: time [s], mask of the open valves."""
        for t, mask in edges:
            self._heard = True
            for jet, up in enumerate(self._opened):
                is_open = bool(mask >> jet & 1)
                if is_open and up is None:
                    self._opened[jet] = t
                elif not is_open and up is not None:
                    self._played[jet].append((up, t))
                    self._opened[jet] = None

    def late_s(self, now: float) -> float:
        """Delay as which the pulses that have ended since the last call count; 0: as planned [s].

        A board that has never reported an edge is not judged.
        """
        worst = 0.0
        for jet, planned in enumerate(self._planned):
            while planned and planned[0][1] < now - REPORTED_S:
                up, down = planned.popleft()
                until = planned[0][0] - EARLY_S if planned else now
                played = self._played_until(jet, until, now)
                worst = max(worst, abs(played - (down - up)))
        return self._counts_as_s if self._heard and worst > OFF_S else 0.0

    def _played_until(self, jet: int, until: float, now: float) -> float:
        """Length of the pulses that have opened before `until`; each counts once [s]."""
        played, total = self._played[jet], 0.0
        while played and played[0][0] < until:
            up, down = played.popleft()
            total += down - up
        opened = self._opened[jet]
        return total + (now - opened if opened is not None and opened < until else 0.0)
