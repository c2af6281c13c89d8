"""A vehicle in another process, as the loop of the host's process sees it."""

from collections.abc import Callable

from testbed.core.codes import FaultId, FaultReport, InhibitReason, Refusal
from testbed.core.types import Health, Inputs, Outputs, Tick, ValveCommand, Wrench
from testbed.net.commands import Ended


class RemoteNode:
    """A vehicle in another process: gives the loop its newest tick.

    `lost_s` is the time without a tick after which it is lost [s].
    """

    def __init__(
        self,
        name: str,
        jets: int,
        exchange: Callable[[bool, FaultReport | None], None],
        lost_s: float,
    ) -> None:
        self.name, self._exchange, self._shut, self.lost_s = name, exchange, (0,) * jets, lost_s
        self.newest: Tick | None = None
        self.received_at = 0.0
        self.ended: Ended | None = None
        self.fault: FaultReport | None = None

    def tick(
        self, t: float, armed: bool, fleet: FaultReport | None = None, *,
        end: bool = False, stay: bool = False,
    ) -> Tick:  # fmt: skip
        """The vehicle's newest tick, or a substitute with a fault if it is silent or has ended."""
        self._exchange(armed, fleet)
        tick = self._newest(t)
        self.fault = tick.outputs.fault
        return tick

    def _newest(self, t: float) -> Tick:
        if self.ended is not None:
            return self._silent(t, InhibitReason.VEHICLE_OVER, self.ended.fault)
        if t - self.received_at > self.lost_s:
            text = f"vehicle silent: not heard for {t - self.received_at:.1f} s"
            fault = FaultReport(FaultId.VEHICLE_SILENT, text)
            return self._silent(t, InhibitReason.VEHICLE_SILENT, fault)
        return self.newest or self._silent(t, InhibitReason.NOT_HEARD_YET, None)

    def _silent(self, t: float, why: InhibitReason, fault: FaultReport | None) -> Tick:
        still, command = Wrench(0.0, 0.0, 0.0), ValveCommand(0, t, t, self._shut, self._shut)
        inputs = Inputs(t, False, (), None, {}, Health(t, 0.0, 0.0))
        return Tick(inputs, Outputs(t, None, None, still, still, command, Refusal(why), fault))
