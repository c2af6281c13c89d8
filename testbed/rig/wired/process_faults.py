"""Injected faults on real wires: what the vehicle's process and the host's do to themselves.

What cameras, air, boards and cables suffer is the business of the twin's server (`server.py`).
"""

import math
import os
import signal
from collections.abc import Callable, Sequence

from testbed.core.fault_injection import Injection, Kind
from testbed.realtime.wall_clock import WallClock, monotonic_ns, sleep_until_ns

OF_PROCESSES: tuple[Kind, ...] = (
    "delay_link", "lose_link", "kill_process", "clock_step", "nan_law", "raise_law",
    "operator_gone", "disk_full", "config_differs", "overrun", "stop_process", "foreign_session",
    "kill_host", "stop_host",
)  # fmt: skip


class ProcessFaults:
    """The injections of a run as one process sees them, by its own clock."""

    def __init__(self, injections: Sequence[Injection], now: Callable[[], float]) -> None:
        self._injections, self._now = injections, now
        self._stepped = 0.0  # what the clock was set by [s]

    def found(self, kind: Kind, vehicle: str | None = None) -> Injection | None:
        """The first injection of this kind that holds now; of any vehicle, without a name."""
        now = self._now()
        for one in self._injections:
            since = math.inf if one.at_s is None else one.at_s
            mine = vehicle is None or one.vehicle == vehicle
            if one.kind == kind and mine and since <= now < since + one.for_s:
                return one
        return None

    def air(self, vehicle: str) -> tuple[float, float]:
        """What messages to a vehicle suffer now: extra delay [s], probability of loss."""
        late, lost = self.found("delay_link", vehicle), self.found("lose_link", vehicle)
        return late.size if late else 0.0, lost.size if lost else 0.0

    def spoilt(self, vehicle: str) -> str:
        """What is wrong with the vehicle's law: "nan", "raise" or nothing."""
        if self.found("nan_law", vehicle):
            return "nan"
        return "raise" if self.found("raise_law", vehicle) else ""

    def at_vehicle(self, name: str, clock: WallClock) -> None:
        """A tick of a vehicle's process begins."""
        if self.found("kill_process", name):
            os.kill(os.getpid(), signal.SIGKILL)
        if self.found("stop_process", name):
            os.kill(os.getpid(), signal.SIGSTOP)
        if late := self.found("overrun", name):
            sleep_until_ns(monotonic_ns() + round(1e9 * late.size))
        step = self.found("clock_step", name)
        wanted = step.size if step else 0.0
        if wanted != self._stepped:
            clock.epoch_ns += round(1e9 * (wanted - self._stepped))
            self._stepped = wanted

    def at_host(self) -> None:
        """A tick of the host's process begins."""
        if self.found("kill_host"):
            os.kill(os.getpid(), signal.SIGKILL)
        if self.found("stop_host"):
            os.kill(os.getpid(), signal.SIGSTOP)
