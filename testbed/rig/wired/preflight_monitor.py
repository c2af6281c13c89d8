"""Monitors a vehicle before its flight, so that the host can query its readiness.

A second flight chain of the same build, never armed, receives poses and the board's reports from
the start. The chain that will fly starts fresh, so that its log can be replayed.
"""

import math
from collections import deque
from collections.abc import Sequence
from threading import Lock

from msgspec.structs import replace

from testbed.config import Experiment
from testbed.core.codes import FaultId, FaultReport
from testbed.core.types import Inputs, State, Vitals
from testbed.flight.arming import Readiness
from testbed.flight.frame_watch import FrameWatch
from testbed.mocap.exposure import MocapSource
from testbed.mocap.poses import MocapPoses
from testbed.net.clock import Reader
from testbed.net.commands import Ready, Refused, config_id
from testbed.net.session import Subscriber
from testbed.realtime.wall_clock import WallClock, monotonic_ns
from testbed.rig.chain import make_agent
from testbed.rig.wired.thrusters import WiredThrusters

ALONE_S = 1.0  # time without a message from a foreign session


class PreflightMonitor:
    """Updates at every call of `look`; `ready` may be called from any thread."""

    def __init__(
        self, experiment: Experiment, name: str, source: MocapSource, thrusters: WiredThrusters,
        reader: Reader, foreign_keys: Sequence[Subscriber],
    ) -> None:  # fmt: skip
        """Start. No message may arrive at `foreign_keys` before the order to start."""
        self._clock = WallClock(monotonic_ns())
        wire = experiment.table.lab.mocap
        self._poses = MocapPoses(source, wire, self._clock, name)
        self._frame = FrameWatch(wire.reference, experiment.table.mocap.noise)
        self._agent, self._thrusters = make_agent(experiment, name), thrusters
        self._period = experiment.flight.jet_period_s
        self._due = 0.0
        self._seen: deque[float] = deque()  # of the poses of the last second [s]
        self._state: State | None = None
        self._looked_at = 0.0
        self._config, self._lock = config_id(experiment), Lock()
        self._reader, self._foreign_keys = reader, foreign_keys
        self._foreign_at = -math.inf  # when a foreign message arrived

    def look(self) -> None:
        """Update with new poses, reports and messages."""
        now = self._clock.now
        if now < self._due:
            return
        self._due = now + self._period
        self._reader.look()
        if sum(len(key.received()) for key in self._foreign_keys):
            self._foreign_at = now
        samples = tuple(self._poses.samples())
        self._frame.look(self._poses.reference_bodies())
        health = self._thrusters.health()
        step = self._agent.step(Inputs(now, False, samples, None, {}, health))
        with self._lock:
            self._seen += [sample.captured_at for sample in samples]
            while self._seen and self._seen[0] < now - 1.0:
                self._seen.popleft()
            self._state, self._looked_at = step.state, now

    def ready(self) -> Ready | Refused:
        """The vehicle's readiness."""
        with self._lock:
            state, rate, at = self._state, float(len(self._seen)), self._looked_at
        trouble = self._thrusters.trouble
        if trouble is not None:
            return Refused(trouble.text)
        if state is not None:  # the pose is old if this process was busy
            late = max(0.0, self._clock.now - at - self._period)
            state = replace(state, pose_age=state.pose_age + late)
        alone = self._clock.now - self._foreign_at > ALONE_S
        why = self._frame.reason or self._frame.unseen
        frame = FaultReport(FaultId.FRAME_MOVED, why) if why else None
        vitals = Vitals(session_ok=alone, clock_offset=self._reader.unsure(), fleet=frame)
        health, shut = self._thrusters.health(), self._thrusters.shut
        return Ready(
            Readiness(at, state, rate, health, vitals, 0.0, shut, {}),
            self._config,
            self._thrusters.board,
        )
