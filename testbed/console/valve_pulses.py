"""The last seconds of every valve, as its board reports them, else as planned."""

from typing import NamedTuple

from testbed.core.types import Tick
from testbed.logs.feed import SeenValves

KEPT_S = 10.0  # of the raster


class Pulse(NamedTuple):
    """One opening of a valve."""

    vehicle: int
    jet: int
    opened: float  # [s]
    shut: float  # [s]


class ValveHistory:
    """The valves of one vehicle."""

    def __init__(self, vehicle: int, jets: int, delay_s: float) -> None:
        self._vehicle, self._delay = vehicle, delay_s
        self._since: list[float | None] = [None] * jets  # open since then, as the board reports
        self.reported = False  # by the board

    def planned(self, tick: Tick) -> list[Pulse]:
        """Pulses of a plan; none once the board reports."""
        if self.reported:
            return []
        command, start = tick.outputs.command, tick.inputs.t + self._delay
        return [
            Pulse(self._vehicle, jet, begin, begin + 1e-6 * on)
            for jet, (on, offset) in enumerate(zip(command.on_us, command.offset_us, strict=True))
            if on > 0
            for begin in (start + 1e-6 * offset,)
        ]

    def driven(self, valves: SeenValves) -> list[Pulse]:
        """Pulses that end with this report of the board."""
        self.reported, found = True, []
        for jet, since in enumerate(self._since):
            is_open = bool(valves.mask >> jet & 1)
            if is_open and since is None:
                self._since[jet] = valves.t
            elif since is not None and not is_open:
                found.append(Pulse(self._vehicle, jet, since, valves.t))
                self._since[jet] = None
        return found

    @property
    def open(self) -> list[Pulse]:
        """Valves that are open now, as the board reports; they shut later."""
        return [
            Pulse(self._vehicle, jet, since, since)
            for jet, since in enumerate(self._since)
            if since is not None
        ]
