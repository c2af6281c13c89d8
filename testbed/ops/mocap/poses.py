"""The cameras as one vehicle hears them: a `PoseSource` on top of any motion-capture system."""

from collections import deque
from collections.abc import Sequence

from testbed.core.lab import MocapWire
from testbed.core.types import PoseSample
from testbed.ops.mocap.exposure import Axes, Exposure, MocapSource
from testbed.ops.mocap.watch import BodyWatch
from testbed.ops.ticking import WallClock


class MocapPoses:
    """Poses of one vehicle, in W and in the run's time.

    Every tracked pose is handed on, believable or not: what to make of it is the fault table's
    business, as on the twin. The watch only says what it looks like, for the log; it sees all
    bodies, because a swap takes two.
    """

    def __init__(
        self, source: MocapSource, wire: MocapWire, clock: WallClock, name: str, watch: BodyWatch
    ) -> None:
        self._source, self._axes, self._clock = source, Axes(wire), clock
        self._body = wire.bodies.get(name, name)
        self.watch = watch
        self.arrived_ns: int | None = None  # of the newest pose handed on
        self.latencies: deque[float] = deque(maxlen=1000)  # exposure to arrival [s]
        self.lost_frames = 0  # by their numbers
        self._number: int | None = None
        self._unseen: deque[tuple[float, Exposure]] = deque(maxlen=1000)

    def samples(self) -> Sequence[PoseSample]:
        """See `PoseSource`."""
        samples = []
        for exposure in self._source.poll():
            if self._number is not None and exposure.number > self._number + 1:
                self.lost_frames += exposure.number - self._number - 1
            self._number = exposure.number
            t = self._clock.of(exposure.exposed_ns)
            self._unseen.append((t, exposure))
            seen = exposure.bodies.get(self._body)
            if seen is not None and seen.tracked:
                pose = self._axes.to_table(seen)
                samples.append(PoseSample(t, pose.x, pose.y, pose.theta))
                self.arrived_ns = exposure.arrived_ns
        return samples

    def review(self) -> None:
        """Look at all bodies, when the plan is out: it does not wait for that."""
        while self._unseen:
            t, exposure = self._unseen.popleft()
            self.latencies.append(1e-9 * (exposure.arrived_ns - exposure.exposed_ns))
            poses = {
                name: self._axes.to_table(seen) if seen.tracked else None
                for name, seen in exposure.bodies.items()
            }
            self.watch.look(t, poses)
        self.watch.pass_time(self._clock.now)

    @property
    def trouble(self) -> str | None:
        """What is wrong with this vehicle's body now."""
        return self.watch.troubles.get(self._body)
