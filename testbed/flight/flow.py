"""Computes how long the gas flows: a plan's open times minus the valves' opening times.

A pulse loses the difference between opening and closing time once. A pulse that lasts to the end of
its plan may continue with the next plan: then it loses nothing in between, and the loss is counted
in the plan where it ends.
"""

import numpy as np
from numpy.typing import NDArray

from testbed.core.compiled import compiled, settled
from testbed.core.pulse import open_time, timing
from testbed.core.types import ValveCommand
from testbed.core.vehicle import Vehicle

Array = NDArray[np.float64]

HAIR = 1e-7  # tolerance [s]; plans are in whole microseconds


@compiled
def flow_shares(times_us, begun, valve, period):
    """Share of a period for which each jet flows by a plan, shape (n,).

    Args:
        times_us: on, then offset in microseconds, shape (2 n,).
        begun: on-time so far of a pulse that may continue, shape (n,) [s]; changed in place.
        valve: its timing.
        period: of the plan [s].
    """
    jets = begun.shape[0]
    share = np.empty(jets)
    for j in range(jets):
        on, offset = 1e-6 * times_us[j], 1e-6 * times_us[jets + j]
        flow = on
        goes_on = on > 0.0 and offset < HAIR
        if begun[j] > 0.0 and not goes_on:
            flow += open_time(0.0, begun[j], valve, 0.0, np.inf) - begun[j]
            begun[j] = 0.0
        if on > 0.0:
            begun[j] += on
            if offset + on < period - HAIR:
                flow += open_time(0.0, begun[j], valve, 0.0, np.inf) - begun[j]
                begun[j] = 0.0
        share[j] = flow / period
    return share


class Flow:
    """Flow of one vehicle's jets, plan by plan."""

    def __init__(self, vehicle: Vehicle, period: float) -> None:
        self._begun = np.zeros(len(vehicle.jets))
        self._valve, self._period = timing(vehicle.valve), period
        self._shares = settled(flow_shares)

    def of(self, command: ValveCommand) -> Array:
        """Share of the period for which each jet flows; the plans have to be given in order."""
        times = np.array(command.on_us + command.offset_us)
        return self._shares(times, self._begun, self._valve, self._period)
