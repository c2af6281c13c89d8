"""One vehicle's `PoseSource` on top of any motion-capture system."""

import math
from collections import deque
from collections.abc import Sequence
from enum import StrEnum

from testbed.core.lab import MocapWire
from testbed.core.types import Pose, PoseSample
from testbed.mocap.exposure import Axes, MocapSource, Sighting
from testbed.realtime.wall_clock import WallClock

OLDEST_NS = 2_000_000_000  # longest time from exposure to arrival
EARLIEST_NS = 100_000_000  # arrival before exposure by clock error is accepted up to this
FARTHEST = 1e4  # largest plausible coordinate [m]
LATE_S = 0.1  # without a frame, or without the body in the frames


class PoseTrouble(StrEnum):
    """Reason why a vehicle gets no poses."""

    SILENT = "silent"  # no frames arrive
    STALE = "stale"  # frames arrive, but the body is not tracked in them


class MocapPoses:
    """Poses of one vehicle, in W and in the run's time.

    Every tracked pose is passed on, plausible or not: the fault table's detectors judge it, as on
    the twin. Only why no poses arrive is found here: the detectors do not see the frames.
    """

    def __init__(self, source: MocapSource, wire: MocapWire, clock: WallClock, name: str) -> None:
        self._source, self._axes, self._clock = source, Axes(wire), clock
        self._body = wire.bodies.get(name, name)
        self._fixed = {one: wire.bodies.get(one, one) for one in wire.reference}
        self._places: dict[str, PoseSample] = {}  # newest poses of reference bodies
        self.trouble: PoseTrouble | None = None
        self.troubles: dict[PoseTrouble, int] = {}  # how often each began
        self._frame_at: float | None = None  # exposure of the newest frame [s]
        self._pose_at = -math.inf  # of the newest one in which the body is tracked [s]
        self.arrived_ns: int | None = None  # arrival of the newest pose passed on
        self.latencies: deque[float] = deque(maxlen=1000)  # exposure to arrival [s]
        self.lost_frames = 0  # from gaps in the frame numbers
        self._number: int | None = None
        self.implausible = 0  # exposures with a wrong time, and own poses not finite

    @property
    def senseless(self) -> int:
        """Number of messages so far, as from the cameras, that were no frames."""
        return int(getattr(self._source, "bad", 0))

    def samples(self) -> Sequence[PoseSample]:
        """See `PoseSource`."""
        samples = []
        for exposure in self._source.poll():
            if self._number is not None and exposure.number > self._number + 1:
                self.lost_frames += exposure.number - self._number - 1
            self._number = exposure.number
            age = exposure.arrived_ns - exposure.exposed_ns
            if not -EARLIEST_NS <= age <= OLDEST_NS:
                self.implausible += 1
                continue
            t = self._clock.of(exposure.exposed_ns)
            self._frame_at = t
            self.latencies.append(1e-9 * age)
            for name, body in self._fixed.items():
                if (one := exposure.bodies.get(body)) and (at := self._seen(one)):
                    self._places[name] = PoseSample(t, at.x, at.y, at.theta)
            seen = exposure.bodies.get(self._body)
            pose = None if seen is None else self._seen(seen)
            if seen is not None and seen.tracked and pose is None:
                self.implausible += 1
            if pose is not None:
                samples.append(PoseSample(t, pose.x, pose.y, pose.theta))
                self._pose_at = t
                self.arrived_ns = exposure.arrived_ns
        return samples

    def reference_bodies(self) -> dict[str, PoseSample]:
        """Newest poses of the reference bodies that were seen since the last call."""
        places, self._places = self._places, {}
        return places

    def review(self) -> None:
        """Note whether frames arrive, and whether the body is tracked in them."""
        now, trouble = self._clock.now, None
        if self._frame_at is None:
            return
        if now - self._frame_at > LATE_S:
            trouble = PoseTrouble.SILENT
        elif now - self._pose_at > LATE_S:
            trouble = PoseTrouble.STALE
        if trouble is not None and trouble is not self.trouble:
            self.troubles[trouble] = self.troubles.get(trouble, 0) + 1
        self.trouble = trouble

    def _seen(self, sighting: Sighting) -> Pose | None:
        """The pose of a body; None if it is not plausible."""
        if not sighting.tracked:
            return None
        if not all(abs(x) < FARTHEST for x in (*sighting.position, *sighting.rotation)):
            return None
        return self._axes.to_table(sighting)
