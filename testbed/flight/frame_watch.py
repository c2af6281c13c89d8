"""Watches the cameras' frame by bodies that never move."""

import math
from collections.abc import Mapping

from testbed.core.codes import FaultId, FaultReport
from testbed.core.se2 import wrap
from testbed.core.types import PoseSample

OFF = 0.005  # a body this far from its place has moved, or the frame has [m]
NOISES = 10.0  # the same in sigmas of the cameras' noise
SHARE = 0.3  # of the newest pose in the mean
ALONE = 0.3  # a body has moved alone if all others are off by less than this share,
STRAIGHT = 0.02  # in their places, and not turned by more than this [rad]


class FrameWatch:
    """The mean deviation of each reference body from its place."""

    def __init__(self, places: Mapping[str, tuple[float, float, float]], noise: float) -> None:
        self._places, self._limit = places, max(OFF, NOISES * noise)
        self._off: dict[str, tuple[float, float, float]] = {}

    def look(self, seen: Mapping[str, PoseSample]) -> None:
        """Take the newest poses."""
        for name, pose in seen.items():
            x, y, theta = self._places[name]
            new = pose.x - x, pose.y - y, wrap(pose.theta - theta)
            old = self._off.get(name, new)
            dx, dy, turn = (a + SHARE * (b - a) for a, b in zip(old, new, strict=True))
            self._off[name] = dx, dy, turn

    @property
    def reason(self) -> str:
        """What has moved, for a person; empty: nothing."""
        far = {name: math.hypot(dx, dy) for name, (dx, dy, _) in self._off.items()}
        off = [name for name in far if far[name] > self._limit]
        if not off:
            return ""
        worst = max(off, key=far.__getitem__)
        rest = [far[name] for name in far if name != worst]
        turned = any(
            abs(turn) > STRAIGHT for name, (*_, turn) in self._off.items() if name != worst
        )
        sizes = ", ".join(f"{name} {1e3 * far[name]:.0f} mm" for name in off)
        alone = len(off) == 1 and not turned
        if rest and alone and max(rest) < ALONE * far[worst]:
            return f"reference body moved: {sizes} off"
        turns = [turn for _, _, turn in self._off.values()]
        turn = math.degrees(sum(turns) / len(turns))
        what = "the cameras' frame moved" if rest else "the cameras' frame or its reference moved"
        return f"{what}: {sizes} off, turned by {turn:.1f} deg"

    @property
    def unseen(self) -> str:
        """Which bodies have never been seen, for a person; empty: none."""
        names = ", ".join(name for name in self._places if name not in self._off)
        return f"the cameras do not see the reference body {names}" if names else ""

    @property
    def fault(self) -> FaultReport | None:
        """The fault that stops all vehicles."""
        return FaultReport(FaultId.FRAME_MOVED, self.reason) if self.reason else None
