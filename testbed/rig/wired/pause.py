"""Notices that the host did not run for a while: stopped, suspended, or starved of the processor.

The vehicles cannot know it. They lose their setpoints and stop, and a host that wakes up hears
nothing from them at first. Both look like a fault of the link or of a vehicle.
"""

from collections.abc import Callable

from testbed.core.codes import FaultId, FaultReport
from testbed.realtime.wall_clock import boot_ns

LONGEST_S = 0.5  # of a healthy loop between two looks; a jet period is 0.1 s
BLAMED = (
    "link_late", "link_out", "link_lost", "operator_gone", "clock_off", FaultId.VEHICLE_SILENT,
)  # fmt: skip


class Pause:
    """The longest time between two looks of the host's loop."""

    def __init__(self, clock: Callable[[], int] = boot_ns) -> None:
        self._clock = clock
        self._looked_ns: int | None = None
        self.longest_s, self.at_s = 0.0, 0.0  # and the time of the run at its end [s]

    def look(self, t: float) -> None:
        """Call it in every turn of the loop, at time `t` of the run [s]."""
        now = self._clock()
        lasted = 0.0 if self._looked_ns is None else 1e-9 * (now - self._looked_ns)
        self._looked_ns = now
        if lasted > self.longest_s:
            self.longest_s, self.at_s = lasted, t

    def blamed(self, fault: FaultReport) -> FaultReport:
        """The pause as the fault, if it explains this one; otherwise the same fault."""
        if self.longest_s <= LONGEST_S or fault.origin.id not in BLAMED:
            return fault
        text = (
            f"the host did not run for {self.longest_s:.1f} s (until t = {self.at_s:.1f} s): it was"
            " stopped or suspended, or the machine is too busy"
        )
        return FaultReport(FaultId.HOST_SUSPENDED, text, notes=(fault.words, *fault.notes))
