"""The last check of a plan before the board gets it, in the process that owns the serial port."""

from collections.abc import Callable

from testbed.core.codes import Refusal
from testbed.core.ports import Thrusters
from testbed.core.types import Health, ValveCommand
from testbed.flight.gate import refuse_plan


class CommandGuard:
    """`Thrusters` that refuse a plan that is late, too long, a replay or invalid.

    A refused plan opens no valve: the previous plan ends, and then the board's watchdog closes the
    valves.
    """

    def __init__(self, thrusters: Thrusters, now: Callable[[], float], longest_s: float) -> None:
        self._thrusters, self._now, self._longest = thrusters, now, longest_s
        self._newest = -1
        self.refused = 0
        self.reason: Refusal | None = None  # of the newest refusal

    def apply(self, command: ValveCommand) -> None:
        """See `Thrusters`."""
        reason = refuse_plan(command, self._now(), self._newest, self._longest)
        if reason is not None:
            self.refused, self.reason = self.refused + 1, reason
            return
        self._newest = command.seq
        self._thrusters.apply(command)

    def land(self) -> None:
        """See `Thrusters`."""
        self._thrusters.land()

    def health(self) -> Health:
        """See `Thrusters`."""
        return self._thrusters.health()
