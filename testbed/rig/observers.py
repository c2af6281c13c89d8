"""Observers for flights without a log."""

from collections.abc import Iterable

from testbed.flight.flown_tick import AnyHostTick, AnyTick
from testbed.flight.loop import host_fault
from testbed.metrics.run_metrics import ReferenceLog


class NullObserver:
    """An observer that does nothing."""

    def vehicle(self, name: str, tick: AnyTick) -> None:
        """See `Observer`."""

    def host(self, name: str, tick: AnyHostTick) -> None:
        """See `Observer`."""

    def done(self, t: float) -> None:
        """See `Observer`."""


class FirstFaultObserver(NullObserver):
    """Keeps the time of the first fault."""

    def __init__(self) -> None:
        self.fault_t: float | None = None  # None: no fault [s]

    def vehicle(self, name: str, tick: AnyTick) -> None:
        """See `Observer`."""
        if self.fault_t is None and tick.fault is not None:
            self.fault_t = tick.t

    def host(self, name: str, tick: AnyHostTick) -> None:
        """See `Observer`."""
        if self.fault_t is None and host_fault(name, tick) is not None:
            self.fault_t = tick.t


class MetricsObserver(FirstFaultObserver):
    """Keeps the data that the metrics need."""

    def __init__(self, names: Iterable[str]) -> None:
        super().__init__()
        self.aims = {name: ReferenceLog() for name in names}

    def vehicle(self, name: str, tick: AnyTick) -> None:
        """See `Observer`."""
        if tick.ended:
            return
        super().vehicle(name, tick)
        self.aims[name].note(tick)
