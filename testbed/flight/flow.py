"""Computes how long the gas flows in the period of each plan, by the model of the valves.

Periods are those of the gas: the opening delay later than those of the commands. The estimate for
a period's end knows the plans so far and takes a pulse that lasts to the end of its plan to be over
there. So does this. If the pulse continues with the next plan, its gas since is made up there. Gas
that comes after the period, because a valve closes slowly, counts in the next one.

The droop is that of the pulses of one plan. A pulse's last gas, which comes when the next plan has
begun, counts as if the other pulses of its own plan went on.
"""

from testbed.core.compiled import compiled
from testbed.core.pulse import Timing, open_time
from testbed.core.scratch import scratch
from testbed.flight.droop import COLUMNS, JET, flow_of, give, note_pulse

INF = float("inf")
HAIR = 1e-7  # tolerance [s]; plans are in whole microseconds
ROUNDED = 1.5e-6  # a pulse that ends nearer to its plan's end lasts to it, see sim_twin/board [s]


@compiled
def flow_shares(times_us, begun, after, model, gives, leaks, period, share):
    """Write the share of a period for which each jet flows by a plan; plans come in order.

    Args:
        times_us: on, then offset in microseconds, shape (2 n,).
        begun: on-time so far of a pulse that may continue, shape (n,) [s]; changed in place.
        after: gas that comes after the period if no pulse continues, shape (n,) [s]; the same.
        model: fired.Model.
        gives: share of its thrust that each jet gives while it is open, shape (n,).
        leaks: and while it is not, shape (n,).
        period: of the plan [s].
        share: written: in times of its whole thrust, without and with droop, shape (2, n).
    """
    jets, valve = begun.shape[0], model.valve
    pulses, count = scratch((jets, COLUMNS)), 0
    # the clock of the gas: the opening delay, which all pulses have, would carry it out of the plan
    gas = Timing(0.0, valve.close_delay - valve.open_delay, valve.open_ramp, valve.close_ramp)
    for j in range(jets):
        on, offset = 1e-6 * times_us[j], 1e-6 * times_us[jets + j]
        goes_on = on > 0.0 and offset < HAIR
        lasts = offset + on > period - ROUNDED
        up = -begun[j] if goes_on else offset
        if on > 0.0 and model.droop > 0.0:
            down = 2.0 * period if lasts else offset + on
            count = note_pulse(pulses, count, j, up, offset, down, gas, 0.0, period)
        flow, after[j] = after[j], 0.0
        if goes_on and begun[j] > 0.0:  # it did not close: all it gives, without what was counted
            flow = -open_time(0.0, begun[j], gas, 0.0, begun[j])
        if on > 0.0:
            flow += open_time(up, offset + on, gas, -INF, period)
            after[j] = open_time(up, offset + on, gas, period, INF)
        begun[j] = offset + on - up if on > 0.0 and lasts else 0.0
        share[0, j] = flow / period
    for j in range(jets):
        share[0, j] = share[1, j] = gives[j] * share[0, j] + leaks[j] * (1.0 - share[0, j])
    if model.droop > 0.0 and (count > 1 or leaks.max() > 0.0):
        weaken(pulses, count, model.droop, gas, gives, leaks, period, share)


@compiled
def weaken(pulses, count, droop, valve, gives, leaks, period, share):
    """Let the droop take its part of the second row of `share`; arguments as of droop.give."""
    jets = gives.shape[0]
    flow, given, whole = scratch(jets), scratch(jets), scratch(jets)
    give(pulses, count, droop, valve, gives, leaks, 0.0, period, flow, given)
    for j in range(jets):
        whole[j] = leaks[j] * period
    for k in range(count):
        j = int(pulses[k, JET])
        whole[j] += (gives[j] - leaks[j]) * flow_of(pulses[k], valve, 0.0, period)
    for j in range(jets):
        if whole[j] > 0.0:
            share[1, j] *= given[j] / whole[j]
