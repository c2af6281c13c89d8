"""Injected faults on real wires that a vehicle's process or the host's injects into itself.

The twin's server injects faults of cameras, air, boards and cables (`server.py`).
"""

import math
import os
import resource
import signal
import subprocess
from collections.abc import Callable, Sequence

from testbed.core.fault_injection import Injection, Kind
from testbed.realtime.wall_clock import WallClock, monotonic_ns, sleep_until_ns

OF_PROCESSES: tuple[Kind, ...] = (
    "delay_link", "lose_link", "kill_process", "clock_step", "nan_law", "raise_law",
    "operator_gone", "disk_full", "config_differs", "overrun", "stop_process", "foreign_session",
    "flood", "no_files",
    "kill_host", "stop_host",
)  # fmt: skip
LONG_S = 60.0  # a process that stops for longer is not continued


class ProcessFaults:
    """The injections of a run in one process, timed by its own clock."""

    def __init__(self, injections: Sequence[Injection], now: Callable[[], float]) -> None:
        self._injections, self._now = injections, now
        self._stepped = 0.0  # injected clock step [s]

    def found(self, kind: Kind, vehicle: str | None = None) -> Injection | None:
        """The first active injection of this kind, for a vehicle or, without a name, for any."""
        now = self._now()
        for one in self._injections:
            since = math.inf if one.at_s is None else one.at_s
            mine = vehicle is None or one.vehicle == vehicle
            if one.kind == kind and mine and since <= now < since + one.for_s:
                return one
        return None

    def radio(self, vehicle: str) -> tuple[float, float]:
        """Extra delay [s] and probability of loss of messages to a vehicle now."""
        late, lost = self.found("delay_link", vehicle), self.found("lose_link", vehicle)
        return late.size if late else 0.0, lost.size if lost else 0.0

    def spoilt(self, vehicle: str) -> str:
        """Injected fault of the vehicle's law: "nan", "raise" or empty."""
        if self.found("nan_law", vehicle):
            return "nan"
        return "raise" if self.found("raise_law", vehicle) else ""

    def at_vehicle(self, name: str, clock: WallClock) -> None:
        """Inject faults at the start of a tick of a vehicle's process."""
        if self.found("kill_process", name):
            os.kill(os.getpid(), signal.SIGKILL)
        if stopped := self.found("stop_process", name):
            _stop(stopped.for_s)
        if self.found("no_files", name):
            _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
            resource.setrlimit(resource.RLIMIT_NOFILE, (0, most))
        if late := self.found("overrun", name):
            sleep_until_ns(monotonic_ns() + round(1e9 * late.size))
        step = self.found("clock_step", name)
        wanted = step.size if step else 0.0
        if wanted != self._stepped:
            clock.epoch_ns += round(1e9 * (wanted - self._stepped))
            self._stepped = wanted

    def at_host(self) -> None:
        """Inject faults at the start of a tick of the host's process."""
        if self.found("kill_host"):
            os.kill(os.getpid(), signal.SIGKILL)
        if stopped := self.found("stop_host"):
            _stop(stopped.for_s)


def _stop(for_s: float) -> None:
    """Stop this process; another one continues it, if that is soon."""
    if for_s < LONG_S:
        wakes = f"sleep {for_s:g}; kill -CONT {os.getpid()}"
        subprocess.Popen(["/bin/sh", "-c", wakes], start_new_session=True)
    os.kill(os.getpid(), signal.SIGSTOP)
