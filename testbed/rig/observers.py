"""Observers for flights without a log."""

from collections.abc import Iterable

from testbed.flight.flown_span import FlownSpan
from testbed.flight.flown_tick import AnyHostTick, AnyTick
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


class MetricsObserver(NullObserver):
    """Keeps the data that the metrics need."""

    def __init__(self, names: Iterable[str]) -> None:
        self.aims = {name: ReferenceLog() for name in names}

    def vehicle(self, name: str, tick: AnyTick) -> None:
        """See `Observer`."""
        if tick.ended:
            return
        self.aims[name].note(tick)

    def ticks(self, span: FlownSpan) -> None:
        """See `NullObserver`; none of them has a fault."""
        for name, rows in span.vehicles.items():
            self.aims[name].note_rows(rows)
