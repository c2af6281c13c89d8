r"""Flow of a commanded pulse through a solenoid valve: dead time, linear ramp, closed form.

    command   ____|^^^^^^^^^^^^^^^^|______________
                  up               down
    flow      __________/^^^^^^^^^^^^^^^^\________
                  |     |  |             | |
                  +open_delay            +close_delay, then the closing ramp
                        open_ramp

A pulse gives a trapezoid, a triangle if closing starts before the opening ramp is over, or no flow
if it starts before the flow. Times are in seconds on any one clock.
"""

from typing import NamedTuple

from testbed.core.compiled import compiled
from testbed.core.vehicle import Valve


class Timing(NamedTuple):
    """A valve's timing for compiled code [s]."""

    open_delay: float
    close_delay: float
    open_ramp: float
    close_ramp: float


def timing(valve: Valve) -> Timing:
    """The valve's timing from the vehicle file."""
    return Timing(valve.open_delay_s, valve.close_delay_s, valve.open_ramp_s, valve.close_ramp_s)


@compiled
def corners(up, down, valve):
    """Flow of a pulse commanded on [up, down): its four corners and its peak.

    Returns:
        (start of rise, end of rise, start of fall, end of fall, peak level in [0, 1]).
    """
    rise = up + valve.open_delay
    fall = down + valve.close_delay
    if fall <= rise:
        return rise, rise, rise, rise, 0.0
    top = rise + valve.open_ramp
    if fall >= top:
        return rise, top, fall, fall + valve.close_ramp, 1.0
    peak = (fall - rise) / valve.open_ramp
    return rise, fall, fall, fall + peak * valve.close_ramp, peak


@compiled
def open_time(up, down, valve, start, end):
    """Integral of the flow of one pulse over [start, end], in seconds of full flow."""
    a, b, c, d, peak = corners(up, down, valve)
    if peak == 0.0 or d <= start or a >= end:
        return 0.0
    total = 0.0
    lo, hi = max(start, a), min(end, b)
    if hi > lo:
        total += peak * (hi - lo) * (0.5 * (lo + hi) - a) / (b - a)
    lo, hi = max(start, b), min(end, c)
    if hi > lo:
        total += peak * (hi - lo)
    lo, hi = max(start, c), min(end, d)
    if hi > lo:
        total += peak * (hi - lo) * (d - 0.5 * (lo + hi)) / (d - c)
    return total
