"""What the other vehicles' ticks say about a vehicle's fault.

A vehicle judges by itself. The loop has the ticks of all of them, and some faults have another
cause in that light. Two vehicles that are seen elsewhere in the same camera frame have the cameras
in common. A vehicle that hears nothing from another one that flies and speaks has lost its link.
"""

from collections import deque
from collections.abc import Sequence
from itertools import pairwise

from testbed.core.codes import Detector, FaultId, FaultReport
from testbed.flight.flown_tick import AnyTick
from testbed.flight.moved_frame import Sight, how_moved, sight_of
from testbed.flight.silence import LINK, lost, silences, silent_for

KEPT = 17  # ticks of each vehicle
ENOUGH = 11  # of them, to judge a link
WORKS = 0.5  # share of the ticks with news from a sender: healthy links lose up to 40 %
NEWER = 1e-6  # [s]
LOOKS = 3  # newest of them in which a step of the frame is sought
LONGEST = 0.5  # from one tick to the next, else the vehicle is expected anywhere [s]
SEEN_ELSEWHERE = tuple(one.words for one in (
    Detector.POSE_JUMP, Detector.POSES_REJECTED, Detector.LATE_STEP, Detector.FRAME_STEP,
    Detector.HEADING_STEP, Detector.BUMPED, Detector.POSE_OF_ANOTHER,
))  # fmt: skip


class Witnesses:
    """The newest ticks of all vehicles of a flight."""

    def __init__(self) -> None:
        self._ticks: dict[str, deque[AnyTick]] = {}

    def add(self, name: str, tick: AnyTick) -> None:
        """Keep a vehicle's tick; a tick that was kept before changes nothing."""
        kept = self._ticks.setdefault(name, deque(maxlen=KEPT))
        if not kept or kept[-1].t < tick.t:
            kept.append(tick)

    def blamed(self, fault: FaultReport) -> FaultReport:
        """The cause that all ticks together show, if there is one; otherwise the same fault."""
        if fault.vehicle not in self._ticks:
            return fault
        report = self._ticks[fault.vehicle][-1].inputs.vitals.fleet
        moved = report is not None and report.origin.id == FaultId.FRAME_MOVED
        shown = report.origin.text if report is not None and moved else ""  # by reference bodies
        if fault.detector == Detector.FLEET.words and shown:
            return FaultReport(FaultId.FRAME_MOVED, shown)
        if fault.detector in SEEN_ELSEWHERE and (how := shown or self._moved(fault)):
            return FaultReport(FaultId.FRAME_MOVED, how, notes=(fault.words, *fault.notes))
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

    def _moved(self, fault: FaultReport) -> str:
        """How the cameras' frame has moved; empty: it has not, or only one vehicle shows it."""
        times = [tick.t for tick in self._ticks[fault.vehicle]][-LOOKS:]
        for t in times:
            seen = [one for ticks in self._ticks.values() if (one := _sight(ticks, t)) is not None]
            if how := how_moved(seen, swapped=fault.detector == Detector.POSE_OF_ANOTHER.words):
                return f"the cameras' frame moved: {how}"
        return ""


def news(ticks: Sequence[AnyTick], sender: str) -> float:
    """In which share of a vehicle's ticks something newer had arrived from a sender."""
    ages = [(tick.t, silences(tick.inputs).get(sender)) for tick in ticks]
    sent = [None if age is None else t - age for t, age in ages]
    newer = [a is None or b > a + NEWER for a, b in pairwise(sent) if b is not None]
    return sum(newer) / max(1, len(ticks) - 1)


def _sight(ticks: deque[AnyTick], t: float) -> Sight | None:
    """Where a vehicle was expected and seen at its tick at `t`."""
    for before, now in pairwise(ticks):
        state = before.outputs.state
        near = now.t == t and t - before.t < LONGEST
        if near and state is not None and len(now.inputs.samples):
            return sight_of(state, now.inputs.samples[-1])
    return None
