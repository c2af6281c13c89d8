"""Notices that the host did not run for a while: stopped, suspended, or starved of the processor.

The vehicles cannot know it. They lose their setpoints and stop, and a host that wakes up hears
nothing from them at first. Both look like a fault of the link or of a vehicle.
"""

from collections.abc import Callable

from testbed.core.codes import FaultId, FaultReport
from testbed.realtime.wall_clock import boot_ns

LONGEST_S = 0.8  # between two turns; vehicles miss the host after 1 s
BLAMED = (
    "link_late", "link_out", "link_lost", "operator_gone", "clock_off", FaultId.VEHICLE_SILENT,
)  # fmt: skip


class Pause:
    """The longest time from the end of a turn of the host's loop to the next turn's beginning.

    What lies between them waits for the next jet period only. A law that is slow, or hangs, is
    asked in a turn, and is named elsewhere.
    """

    def __init__(self, clock: Callable[[], int] = boot_ns) -> None:
        self._clock = clock
        self._since_ns: int | None = None
        self.longest_s, self.at_s = 0.0, 0.0  # and the time of the run at its end [s]

    @property
    def began_s(self) -> float:
        """Time of the run at its beginning [s]."""
        return self.at_s - self.longest_s

    def turn_ends(self) -> None:
        """The loop waits from now on."""
        self._since_ns = self._clock()

    def turn_begins(self, t: float) -> None:
        """It has waited, at time `t` of the run [s]; can be called repeatedly."""
        if self._since_ns is None:
            return
        lasted, self._since_ns = 1e-9 * (self._clock() - self._since_ns), None
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
