"""The cameras as one vehicle hears them: a `PoseSource` on top of any motion-capture system."""

from collections import deque
from collections.abc import Sequence

from testbed.core.lab import MocapWire
from testbed.core.types import Pose, PoseSample
from testbed.mocap.body_monitor import BodyMonitor
from testbed.mocap.exposure import Axes, Exposure, MocapSource, Sighting
from testbed.realtime.wall_clock import WallClock

OLDEST_NS = 2_000_000_000  # from exposure to arrival
EARLIEST_NS = 100_000_000  # the other way: clocks are known to some milliseconds
FARTHEST = 1e4  # [m] no camera sees so far


class MocapPoses:
    """Poses of one vehicle, in W and in the run's time.

    Every tracked pose is handed on, believable or not: what to make of it is the fault table's
    business, as on the twin. The watch only says what it looks like, for the log; it sees all
    bodies, because a swap takes two.
    """

    def __init__(
        self, source: MocapSource, wire: MocapWire, clock: WallClock, name: str, watch: BodyMonitor
    ) -> None:
        self._source, self._axes, self._clock = source, Axes(wire), clock
        self._body = wire.bodies.get(name, name)
        self.watch = watch
        self.arrived_ns: int | None = None  # of the newest pose handed on
        self.latencies: deque[float] = deque(maxlen=1000)  # exposure to arrival [s]
        self.lost_frames = 0  # by their numbers
        self._number: int | None = None
        self.implausible = 0  # exposures of another time, and own poses that are no numbers
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
        """Look at all bodies, when the plan is out: it does not wait for that."""
        while self._unseen:
            t, exposure = self._unseen.popleft()
            self.watch.look(t, {n: self._seen(seen) for n, seen in exposure.bodies.items()})
        self.watch.pass_time(self._clock.now)

    def _seen(self, sighting: Sighting) -> Pose | None:
        """Where a body is, if that is known."""
        if not sighting.tracked:
            return None
        if not all(abs(x) < FARTHEST for x in (*sighting.position, *sighting.rotation)):
            return None
        return self._axes.to_table(sighting)

    @property
    def trouble(self) -> str | None:
        """What is wrong with this vehicle's body now."""
        return self.watch.troubles.get(self._body)
