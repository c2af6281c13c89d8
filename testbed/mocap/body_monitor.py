"""What can be wrong with a body on the screen of a motion-capture system, told apart. Pure.

    silent    no frames come at all
    stale     frames come, the body is not tracked in them
    frozen    it is tracked, and its pose does not change by a bit: a real one is never that still
    jumped    it is somewhere it cannot have got to
    swapped   it jumped to where another body was, and the other one away from there

It names, for the log. The responses are those of the fault table, which has detectors of its own.
"""

import math
from collections.abc import Mapping
from enum import StrEnum

from msgspec import Struct

from testbed.core.types import Pose


class Trouble(StrEnum):
    """Of one body."""

    SILENT = "silent"
    STALE = "stale"
    FROZEN = "frozen"
    JUMPED = "jumped"
    SWAPPED = "swapped"


class WatchParams(Struct, frozen=True, forbid_unknown_fields=True):
    """When something is wrong."""

    silent_s: float = 0.1
    stale_s: float = 0.1
    frozen_frames: int = 5  # identical ones in a row; noise makes two in a row unlikely already
    fastest: float = 2.0  # [m/s] no vehicle moves like that, even when it is pushed by hand
    reach: float = 0.03  # a jump is at least so long [m]


class _Seen(Struct):
    """One body, as it was believed last."""

    t: float
    pose: Pose
    repeats: int = 0


class BodyMonitor:
    """Looks at every exposure; times in seconds of any one clock."""

    def __init__(self, params: WatchParams | None = None) -> None:
        self._p = params or WatchParams()
        self._seen: dict[str, _Seen] = {}
        self._heard_at: float | None = None
        self.troubles: dict[str, Trouble] = {}  # of each body that has one, as of now
        self.counts: dict[Trouble, int] = {}  # how often each began

    def look(self, t: float, bodies: Mapping[str, Pose | None]) -> dict[str, Pose]:
        """The poses of one exposure that can be believed; None is a body that is not tracked."""
        self._heard_at = t
        for name in bodies:
            if self.troubles.get(name) is Trouble.SILENT:
                self._note(name, None)
        jumps = {n: p for n, p in bodies.items() if p is not None and self._jumped(n, t, p)}
        good: dict[str, Pose] = {}
        for name, pose in bodies.items():
            seen = self._seen.get(name)
            if pose is None:
                self._untracked(name, t)
            elif seen is None:
                self._seen[name] = _Seen(t, pose)
                good[name] = pose
                self._note(name, None)
            elif name in jumps:
                swapped = any(
                    self._near(name, jumps[other], t) and self._near(other, pose, t)
                    for other in jumps
                    if other != name
                )
                self._note(name, Trouble.SWAPPED if swapped else Trouble.JUMPED)
            elif pose == seen.pose:
                seen.repeats += 1
                seen.t = t
                if seen.repeats >= self._p.frozen_frames:
                    self._note(name, Trouble.FROZEN)
                else:
                    good[name] = pose
            else:
                self._seen[name] = _Seen(t, pose)
                good[name] = pose
                self._note(name, None)
        return good

    def pass_time(self, t: float) -> None:
        """No exposure came up to `t`."""
        if self._heard_at is not None and t - self._heard_at > self._p.silent_s:
            for name in self._seen:
                self._note(name, Trouble.SILENT)

    def _jumped(self, name: str, t: float, pose: Pose) -> bool:
        return name in self._seen and not self._near(name, pose, t)

    def _near(self, name: str, pose: Pose, t: float) -> bool:
        """Whether the body called `name` may have got to `pose` by now."""
        seen = self._seen[name]
        far = math.hypot(pose.x - seen.pose.x, pose.y - seen.pose.y)
        return far <= self._p.reach + self._p.fastest * max(0.0, t - seen.t)

    def _untracked(self, name: str, t: float) -> None:
        seen = self._seen.get(name)
        if seen is None or t - seen.t > self._p.stale_s:
            self._note(name, Trouble.STALE)

    def _note(self, name: str, trouble: Trouble | None) -> None:
        if trouble is None:
            self.troubles.pop(name, None)
        elif self.troubles.get(name) is not trouble:
            self.troubles[name] = trouble
            self.counts[trouble] = self.counts.get(trouble, 0) + 1
