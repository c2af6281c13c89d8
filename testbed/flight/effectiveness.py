"""What each jet really gives: a slow estimate in flight, beside the detector of faults.

Least squares over the same looks as `jet_faults`, with a memory of minutes: the residual momentum
is explained by the thrust of every jet, the centre of mass and the slope together. The estimate is
shown; a vehicle flies by it only if `flight.online.jets` says so. A pull that begins or ends in
flight looks like weak jets, so then the estimate begins anew.
"""

import numpy as np

from testbed.core.compiled import compiled
from testbed.core.scratch import scratch

MEMORY_S = 120.0  # time constant of forgetting [s]
SPREAD = 0.3  # of a jet's share before anything is heard of it, one sigma
MOST = 1.5  # largest share that is shown
WHITENESS = 2.0  # the residuals of successive looks depend on each other: sigmas are wider by this


@compiled
def learn(slow, spread, x, bias, period, rough):
    """Add a look to the sums, in place.

    Args:
        slow: z'z, and z'e as the last column, shape (m, m + 1).
        spread: variance of the residual, push and turn, shape (2,).
        x: z first, and the residual as the last column, see jet_faults.residual.
        bias: what the residual lacks, the mean of unexplained acceleration [m/s^2], shape (2,).
        period: of a look [s].
        rough: see jet_faults.Known.
    """
    m, last = slow.shape[0], x.shape[1] - 1
    push, spun, keep = 1.0 / (spread[0] + rough), 1.0 / spread[1], 1.0 - min(0.5, period / MEMORY_S)
    ex, ey, turn = x[0, last] + period * bias[0], x[1, last] + period * bias[1], x[2, last]
    for i in range(m):
        a, b, c = x[0, i] * push, x[1, i] * push, x[2, i] * spun
        for k in range(m):
            slow[i, k] = keep * slow[i, k] + (a * x[0, k] + b * x[1, k] + c * x[2, k])
        slow[i, m] = keep * slow[i, m] + (a * ex + b * ey + c * turn)


@compiled
def resolve(slow, sure, slope, off, sigma):
    """Write each jet's deviation from the thrust that is assumed, as a share of it, and its sigma.

    Args:
        slow: of jet_faults.Heard, see `learn`.
        sure: 1 / tolerance^2 of z, shape (m,): of the centre of mass.
        slope: 1 / variance of the slope [s^4/m^2].
        off: shape (jets,).
        sigma: shape (jets,).
    """
    m, n = slow.shape[0], off.shape[0]
    root, inverse = scratch((m, m)), scratch((m, m))
    for i in range(m):
        for k in range(i + 1):
            total = slow[i, k]
            if i == k:
                total += 1.0 / SPREAD**2 if i < n else slope if i >= m - 2 else sure[i]
            for q in range(k):
                total -= root[i, q] * root[k, q]
            root[i, k] = np.sqrt(total) if i == k else total / root[k, k]
    for h in range(m):  # of the triangle
        inverse[h, h] = 1.0 / root[h, h]
        for i in range(h + 1, m):
            total = 0.0
            for q in range(h, i):
                total -= root[i, q] * inverse[q, h]
            inverse[i, h] = total / root[i, i]
    for j in range(n):
        off[j] = variance = 0.0
        for i in range(j, m):
            variance += inverse[i, j] * inverse[i, j]
            told = 0.0
            for k in range(i + 1):
                told += inverse[i, k] * slow[k, m]
            off[j] += inverse[i, j] * told
        sigma[j] = min(SPREAD, WHITENESS * np.sqrt(variance))
