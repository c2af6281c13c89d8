"""What the other vehicles' ticks say about a vehicle's fault.

A vehicle judges by itself. The loop has the ticks of all of them, and some faults have another
cause in that light. A vehicle that hears nothing from another one that flies and speaks has lost
its link.
"""

from collections import deque
from collections.abc import Sequence
from itertools import pairwise

from testbed.core.codes import Detector, FaultReport
from testbed.flight.flown_tick import AnyTick
from testbed.flight.silence import LINK, lost, silences, silent_for

KEPT = 17  # ticks of each vehicle
ENOUGH = 11  # of them, to judge a link
WORKS = 0.5  # share of the ticks with news from a sender: healthy links lose up to 40 %
NEWER = 1e-6  # [s]


class Witnesses:
    """The newest ticks of all vehicles of a flight."""

    def __init__(self) -> None:
        self._ticks: dict[str, deque[AnyTick]] = {}

    def hear(self, name: str, tick: AnyTick) -> None:
        """Keep a vehicle's tick; a tick that was kept before changes nothing."""
        kept = self._ticks.setdefault(name, deque(maxlen=KEPT))
        if not kept or kept[-1].t < tick.t:
            kept.append(tick)

    def blamed(self, fault: FaultReport) -> FaultReport:
        """The cause that all ticks together show, if there is one; otherwise the same fault."""
        if fault.vehicle not in self._ticks:
            return fault
        if fault.detector == Detector.NEIGHBOUR_AGE.words and fault.id != LINK:
            return self._deaf(fault)
        return fault

    def _deaf(self, fault: FaultReport) -> FaultReport:
        """The lost link of a vehicle that misses most of what all others send to it."""
        ticks = list(self._ticks[fault.vehicle])
        silent = silences(ticks[-1].inputs)
        if len(silent) == 1:  # the sender is at fault, unless it flies
            other = self._ticks.get(next(iter(silent)))
            flies = other is not None and other[-1].outputs.state is not None
            return lost(fault, silent_for(silent)) if flies else fault
        share = max((news(ticks, sender) for sender in silent), default=1.0)
        if len(ticks) < ENOUGH or share > WORKS:
            return fault
        lasted, who = ticks[-1].t - ticks[0].t, ", ".join(sorted(silent))
        return lost(fault, f"at most {share:.0%} heard in {lasted:.1f} s of what {who} sent")


def news(ticks: Sequence[AnyTick], sender: str) -> float:
    """In which share of a vehicle's ticks something newer had arrived from a sender."""
    ages = [(tick.t, silences(tick.inputs).get(sender)) for tick in ticks]
    sent = [None if age is None else t - age for t, age in ages]
    newer = [a is None or b > a + NEWER for a, b in pairwise(sent) if b is not None]
    return sum(newer) / max(1, len(ticks) - 1)
