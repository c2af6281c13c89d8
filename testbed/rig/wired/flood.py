"""Notices a port of a vehicle that is flooded: far more messages than any flight sends."""

from collections.abc import Callable, Mapping

from testbed.core.codes import FaultId, FaultReport

FLOOD_HZ = 200.0  # messages of a key; a flight sends one in each jet period, at most 50 a second
CAMERA_HZ = 20.0  # messages that are no frames; cameras send none
LOOK_S = 0.5
BLAMED = (
    "link_late", "link_out", "link_lost", "operator_gone", "neighbour_late", "neighbour_missing",
    "neighbour_silent", "overrun", "clock_off", FaultId.BOARD_LEFT_ARMED,
)  # fmt: skip
OF_CAMERAS = ("pose_stale", "pose_missing", "pose_lost", "pose_rate_low")


class FloodWatch:
    """Counts what arrives at a vehicle's ports.

    Args:
        keys: number of messages so far, by what they carry.
        cameras: number of messages so far, as from the cameras, that were no frames.
    """

    def __init__(
        self, keys: Callable[[], Mapping[str, int]], cameras: Callable[[], int] = lambda: 0
    ) -> None:
        self._keys, self._cameras = keys, cameras
        self._looked_at, self._before = 0.0, self._counts()
        self.since: float | None = None  # time of the run at which it was noticed [s]
        self._port, self._rate = "", 0.0  # of the worst flood

    def _counts(self) -> dict[str, int]:
        return {**self._keys(), "cameras": self._cameras()}

    def look(self, now: float) -> None:
        """Compare the counts with those of half a second ago."""
        if now - self._looked_at < LOOK_S:
            return
        counts, lasted = self._counts(), now - self._looked_at
        for port, count in counts.items():
            rate = (count - self._before.get(port, 0)) / lasted
            if rate > (CAMERA_HZ if port == "cameras" else FLOOD_HZ) and rate > self._rate:
                self.since = now if self.since is None else self.since
                self._port, self._rate = port, rate
        self._looked_at, self._before = now, counts

    def blamed(self, fault: FaultReport) -> FaultReport:
        """The flood as the fault, if it explains this one; otherwise the same fault."""
        explained = (*BLAMED, *OF_CAMERAS) if self._port == "cameras" else BLAMED
        if self.since is None or fault.origin.id not in explained:
            return fault
        text = f"a flood: {self._rate:.0f} messages a second at its port for {self._port}"
        return FaultReport(FaultId.FLOODED, text, fault.vehicle, notes=(fault.words, *fault.notes))
