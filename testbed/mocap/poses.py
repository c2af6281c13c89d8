"""One vehicle's `PoseSource` on top of any motion-capture system."""

from collections import deque
from collections.abc import Sequence

from testbed.core.lab import MocapWire
from testbed.core.types import Pose, PoseSample
from testbed.mocap.body_monitor import BodyMonitor
from testbed.mocap.exposure import Axes, Exposure, MocapSource, Sighting
from testbed.realtime.wall_clock import WallClock

OLDEST_NS = 2_000_000_000  # longest time from exposure to arrival
EARLIEST_NS = 100_000_000  # arrival before exposure by clock error is accepted up to this
FARTHEST = 1e4  # largest plausible coordinate [m]


class MocapPoses:
    """Poses of one vehicle, in W and in the run's time.

    Every tracked pose is passed on, plausible or not: the fault table judges it, as on the twin.
    The body watch only names faults for the log; it gets all bodies, as a swap involves two.
    """

    def __init__(
        self, source: MocapSource, wire: MocapWire, clock: WallClock, name: str, watch: BodyMonitor
    ) -> None:
        self._source, self._axes, self._clock = source, Axes(wire), clock
        self._body = wire.bodies.get(name, name)
        self.watch = watch
        self.arrived_ns: int | None = None  # arrival of the newest pose passed on
        self.latencies: deque[float] = deque(maxlen=1000)  # exposure to arrival [s]
        self.lost_frames = 0  # from gaps in the frame numbers
        self._number: int | None = None
        self.implausible = 0  # exposures with a wrong time, and own poses not finite
        self._unseen: deque[tuple[float, Exposure]] = deque(maxlen=1000)

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
            self._unseen.append((t, exposure))
            self.latencies.append(1e-9 * age)
            seen = exposure.bodies.get(self._body)
            pose = None if seen is None else self._seen(seen)
            if seen is not None and seen.tracked and pose is None:
                self.implausible += 1
            if pose is not None:
                samples.append(PoseSample(t, pose.x, pose.y, pose.theta))
                self.arrived_ns = exposure.arrived_ns
        return samples

    def review(self) -> None:
        """Check all bodies; called after the plan is sent, so that the plan does not wait."""
        while self._unseen:
            t, exposure = self._unseen.popleft()
            self.watch.look(t, {n: self._seen(seen) for n, seen in exposure.bodies.items()})
        self.watch.pass_time(self._clock.now)

    def _seen(self, sighting: Sighting) -> Pose | None:
        """The pose of a body; None if it is not plausible."""
        if not sighting.tracked:
            return None
        if not all(abs(x) < FARTHEST for x in (*sighting.position, *sighting.rotation)):
            return None
        return self._axes.to_table(sighting)

    @property
    def trouble(self) -> str | None:
        """The current fault of this vehicle's body."""
        return self.watch.troubles.get(self._body)
