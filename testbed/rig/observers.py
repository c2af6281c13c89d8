"""Observers of a flight for whoever flies without a log."""

from collections.abc import Iterable

from testbed.core.types import HostTick, Tick
from testbed.metrics.run_metrics import ReferenceLog


class NullObserver:
    """An observer that looks away."""

    def vehicle(self, name: str, tick: Tick) -> None:
        """See `Observer`."""

    def host(self, name: str, tick: HostTick) -> None:
        """See `Observer`."""

    def done(self, t: float) -> None:
        """See `Observer`."""


class MetricsObserver(NullObserver):
    """Keeps what the metrics need."""

    def __init__(self, names: Iterable[str]) -> None:
        self.aims = {name: ReferenceLog() for name in names}

    def vehicle(self, name: str, tick: Tick) -> None:
        """See `Observer`."""
        if tick.inputs.vitals.end:
            return
        self.aims[name].note(tick.outputs)
