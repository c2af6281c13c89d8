"""Evaluates the fault table on one vehicle, tick by tick: numbers in, response out."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.codes import Response
from testbed.core.compiled import compiled
from testbed.flight.faults import FaultTable

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

WARN = Response.WARN.value


class Rows(NamedTuple):
    """The fault table for compiled code; every array has one element a row."""

    detector: Integers  # codes.Detector
    low: Array  # the row holds below this
    high: Array  # or above this
    misses: Integers  # after so many ticks in a row
    timeout: Array  # and after this time [s]
    response: Integers  # codes.Response
    latched: Integers  # 1: it stays until a reset
    reconfigures: Integers  # 1: `response` only if the jets left do not suffice


def rows_of(table: FaultTable) -> Rows:
    """The rows of a fault table."""
    rows = list(table.values())
    inf = float("inf")
    return Rows(
        np.array([row.measures for row in rows], dtype=np.int64),
        np.array([-inf if row.below is None else row.below for row in rows]),
        np.array([inf if row.above is None else row.above for row in rows]),
        np.array([row.misses for row in rows], dtype=np.int64),
        np.array([row.timeout_s for row in rows]),
        np.array([row.code for row in rows], dtype=np.int64),
        np.array([row.latched for row in rows], dtype=np.int64),
        np.array([row.reconfigures for row in rows], dtype=np.int64),
    )


class Counters(NamedTuple):
    """Memory of the monitor, one element a row, changed in place."""

    ticks: Array  # in a row beyond the bound
    since: Array  # the first of them [s]
    holds: Array  # 1: it holds now
    latched: Array  # its place in the order of latching, from 1; 0: not latched
    value: Array  # the number with which it was latched


@compiled
def look(p, counters, t, latches, numbers, outputs):
    """Judge a tick: write the most severe response and the deciding fault to `outputs`.

    Returns the row that asks for a reconfiguration, -1: none.

    Args:
        p: Rows.
        counters: Counters.
        t: now [s].
        latches: false: faults are not latched, as of a disarmed vehicle.
        numbers: of the detectors.
        outputs: record.OUTPUTS.
    """
    outputs.response, outputs.fault, outputs.holding, asks = 0, -1, 0, -1
    for k in range(p.detector.shape[0]):
        number = numbers[p.detector[k]]
        if p.low[k] <= number <= p.high[k]:
            counters.ticks[k] = counters.holds[k] = 0.0
        else:
            count(p, counters, k, t)
            if counters.holds[k] == 1.0 and latches:
                if p.reconfigures[k] == 1 and counters.latched[k] == 0.0:
                    asks = k
                elif p.latched[k] == 1:
                    latch(counters, k, number)
        outputs.holding += int(counters.holds[k])
        latched = counters.latched[k]
        if latched > 0.0 or (counters.holds[k] == 1.0 and p.reconfigures[k] == 0):
            outputs.response = max(outputs.response, p.response[k])
        elif counters.holds[k] == 1.0:
            outputs.response = max(outputs.response, WARN)
        if latched > 0.0 and decides(p, counters, k, outputs.fault):
            outputs.fault = k
    return asks


@compiled
def refuse(p, counters, k, number, outputs):
    """Latch row `k`: the jets left do not suffice."""
    latch(counters, k, number)
    outputs.response = max(outputs.response, p.response[k])
    if decides(p, counters, k, outputs.fault):
        outputs.fault = k


@compiled
def count(p, counters, k, t):
    """Count one more tick of row `k` beyond its bound."""
    if counters.ticks[k] == 0.0:
        counters.since[k] = t
    counters.ticks[k] += 1.0
    lasts = counters.ticks[k] >= p.misses[k] and t - counters.since[k] >= p.timeout[k]
    counters.holds[k] = 1.0 if lasts else 0.0


@compiled
def latch(counters, k, number):
    """Latch row `k`, after those that are latched."""
    if counters.latched[k] == 0.0:
        counters.latched[k] = counters.latched.max() + 1.0
        counters.value[k] = number


@compiled
def decides(p, counters, k, other):
    """Whether latched row `k` decides, and not `other`: the first of the most severe does."""
    if other < 0 or p.response[k] > p.response[other]:
        return True
    same = p.response[k] == p.response[other]
    return same and counters.latched[k] < counters.latched[other]


@compiled
def reset(counters):
    """Clear latched faults; a row that still holds latches again at the next tick."""
    counters.ticks[:] = counters.holds[:] = counters.latched[:] = 0.0
