"""Observers for flights without a log."""

from collections.abc import Iterable

from testbed.flight.flown_span import FlownSpan
from testbed.flight.flown_tick import AnyHostTick, AnyTick
from testbed.flight.loop import host_fault
from testbed.metrics.run_metrics import ReferenceLog

EACH = "vehicle", "host", "done"  # what an observer may do at each tick


class NullObserver:
    """An observer that does nothing."""

    def vehicle(self, name: str, tick: AnyTick) -> None:
        """See `Observer`."""

    def host(self, name: str, tick: AnyHostTick) -> None:
        """See `Observer`."""

    def done(self, t: float) -> None:
        """See `Observer`."""

    def ticks(self, span: FlownSpan) -> None:
        """Receive ticks of the twin that were flown together.

        `ticks = None` in a class means that it changes the flight: the twin must not be ahead.
        """
        if handles_single_ticks(self):
            span.show(self)


def handles_single_ticks(observer: NullObserver) -> bool:
    """Whether it does something at every single tick."""
    return any(getattr(type(observer), one) is not getattr(NullObserver, one) for one in EACH)


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

    def ticks(self, span: FlownSpan) -> None:
        """See `NullObserver`; none of them has a fault."""
        for name, rows in span.vehicles.items():
            self.aims[name].note_rows(rows)
