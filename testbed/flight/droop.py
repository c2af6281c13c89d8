"""What jets give while others are open: the supply droops.

With n open jets each gives 1 / (1 + k (n - 1)) of its thrust, k being the droop of the vehicle's
file. A valve is open from its first gas to its last. Pulses overlap for a part of a period only,
and jets that are open one after the other do not weaken each other, so the share is worked out
between those instants. From the mean number of open jets it would be another one.
"""

from testbed.core.compiled import compiled
from testbed.core.pulse import corners, open_time
from testbed.core.scratch import scratch

JET, UP, SINCE, DOWN, FIRST, LAST = range(6)  # columns of pulses
COLUMNS = 6


@compiled
def note_pulse(pulses, count, jet, up, since, down, valve, start, end):
    """Write a pulse to row `count` of `pulses` if it flows in [start, end]; return the new count.

    Args:
        pulses: shape (rows, COLUMNS).
        count: rows that are used.
        jet: its number.
        up: when the valve is commanded to open [s].
        since: the pulse gives only what a pulse from `up` to `since` does not give [s].
        down: when the valve is commanded to close [s].
        valve: its timing.
        start: [s].
        end: [s].
    """
    first, _, _, last, peak = corners(up, down, valve)
    if peak == 0.0 or last <= start or first >= end:
        return count
    pulse = pulses[count]
    pulse[JET], pulse[UP], pulse[SINCE], pulse[DOWN] = jet, up, since, down
    pulse[FIRST], pulse[LAST] = first, last
    return count + 1


@compiled
def flow_of(pulse, valve, start, end):
    """For how long a pulse flows in [start, end], without droop [s]."""
    flow = open_time(pulse[UP], pulse[DOWN], valve, start, end)
    if pulse[SINCE] > pulse[UP]:
        flow -= open_time(pulse[UP], pulse[SINCE], valve, start, end)
    return flow


@compiled
def give(pulses, count, droop, valve, gives, leaks, start, end, flow, given):
    """Write what each jet gives in [start, end], in times of its whole thrust, droop included.

    Args:
        pulses: see `note_pulse`.
        count: of them.
        droop: see vehicle.Air.
        valve: timing of the valves.
        gives: share of its thrust that each jet gives while it is open, (n,).
        leaks: and while it is not, (n,).
        start: [s].
        end: [s].
        flow: written: what a jet gives that does what is commanded, (n,) [s].
        given: written: what the jets give as they are, (n,) [s].
    """
    n, cuts = gives.shape[0], scratch(2 * count + 2)
    weight = scratch(n)
    leaky = 0.0
    for j in range(n):
        leaky += leaks[j]
        flow[j] = given[j] = 0.0
    pieces, cuts[0], cuts[1] = 1, start, end
    if droop > 0.0 and (count > 1 or leaky > 0.0):
        for k in range(count):
            for at in (pulses[k, FIRST], pulses[k, LAST]):
                if start < at < end:
                    i = pieces  # sorted in
                    while cuts[i - 1] > at:
                        cuts[i] = cuts[i - 1]
                        i -= 1
                    cuts[i] = at
                    pieces += 1
                    cuts[pieces] = end
    for i in range(pieces):
        since, until = cuts[i], cuts[i + 1]
        middle, share = 0.5 * (since + until), 1.0
        if droop > 0.0:
            for j in range(n):
                weight[j] = leaks[j]
            for k in range(count):
                if pulses[k, FIRST] < middle < pulses[k, LAST]:
                    j = int(pulses[k, JET])
                    weight[j] = gives[j]
            open_jets = 0.0
            for j in range(n):
                open_jets += weight[j]
            share = 1.0 / (1.0 + droop * max(0.0, open_jets - 1.0))
        if leaky > 0.0:
            for j in range(n):
                given[j] += share * leaks[j] * (until - since)
        for k in range(count):
            pulse = pulses[k]
            if pulse[FIRST] < until and pulse[LAST] > since:
                j, own = int(pulse[JET]), share * flow_of(pulse, valve, since, until)
                flow[j] += own
                given[j] += (gives[j] - leaks[j]) * own
