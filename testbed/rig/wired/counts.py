"""Counts of messages and frames on one vehicle, taken at the end of its flight."""

import math

import numpy as np

from testbed.mocap.poses import MocapPoses
from testbed.net.commands import Counts
from testbed.net.links import ZenohVehicleLink
from testbed.realtime.clock_sync import ClockOffset
from testbed.rig.wired.thrusters import WiredThrusters


def count(
    link: ZenohVehicleLink, thrusters: WiredThrusters, poses: MocapPoses, clock: ClockOffset,
    unsent: int,
) -> Counts:  # fmt: skip
    """Collect the counts; `unsent` is the number of plans that the command guard refused."""
    best = clock.best
    latency = float(np.median(poses.latencies)) if poses.latencies else math.nan
    return Counts(
        commands={str(k): n for k, n in link.setpoints.inbox.counts.items()},
        refusals=thrusters.refusals | ({"not_sent": unsent} if unsent else {}),
        mocap={str(k): n for k, n in poses.troubles.items()},
        lost_frames=poses.lost_frames,
        reconnects=thrusters.reconnects,
        mocap_latency_ms=None if math.isnan(latency) else 1e3 * latency,
        clock_offset_ms=None if best is None else 1e-6 * best.offset_ns,
    )
