"""Computes how long the gas flows: a plan's open times minus the valves' opening times.

A pulse loses the difference between opening and closing time once. A pulse that lasts to the end of
its plan may continue with the next plan: then it loses nothing in between, and the loss is counted
in the plan where it ends.
"""

from testbed.core.compiled import compiled
from testbed.core.pulse import open_time

INF = float("inf")
HAIR = 1e-7  # tolerance [s]; plans are in whole microseconds
ROUNDED = 1.1e-6  # a pulse ends so long before its plan at most: the period is rounded, too [s]


@compiled
def flow_shares(times_us, begun, valve, period, share):
    """Write the share of a period for which each jet flows by a plan; plans come in order.

    Args:
        times_us: on, then offset in microseconds, shape (2 n,).
        begun: on-time so far of a pulse that may continue, shape (n,) [s]; changed in place.
        valve: its timing.
        period: of the plan [s].
        share: shape (n,).
    """
    jets = begun.shape[0]
    for j in range(jets):
        on, offset = 1e-6 * times_us[j], 1e-6 * times_us[jets + j]
        flow = on
        goes_on = on > 0.0 and offset < HAIR
        if begun[j] > 0.0 and not goes_on:
            flow += open_time(0.0, begun[j], valve, 0.0, INF) - begun[j]
            begun[j] = 0.0
        if on > 0.0:
            begun[j] += on
            if offset + on < period - ROUNDED:
                flow += open_time(0.0, begun[j], valve, 0.0, INF) - begun[j]
                begun[j] = 0.0
        share[j] = flow / period
