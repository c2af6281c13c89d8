"""What each jet really gives: a slow estimate in flight, beside the detector of faults.

Least squares over the innovations (`innovations.py`), with a memory of minutes: they are explained
by the thrust and direction of every jet, the inertia and the centre of mass together; the slope is
in their filter. The estimate is shown; a vehicle flies by it only if `flight.online.jets` says so.
A pull that begins or ends in flight looks like weak jets, so then the estimate begins anew.

The estimated velocity is no basis for it: a law that closes the loop itself answers its noise, the
noise then fades by itself, and every jet seemed to give 6 to 9 % more than it did.
"""

import numpy as np

from testbed.core.compiled import compiled
from testbed.core.scratch import scratch

MEMORY_S = 120.0  # time constant of forgetting [s]
SPREAD = 0.3  # of a jet's share before anything is heard of it, one sigma
MOST = 1.5  # largest share that is shown


@compiled
def learn(slow, g, error, weight, period):
    """Add a look to the sums, in place.

    Args:
        slow: z'z, and z'e as the last column, shape (m, m + 1).
        g: what z changes in the innovation of each axis, shape (3, m).
        error: the innovations, shape (3,).
        weight: 1 / variance of each, shape (3,).
        period: of a look [s].
    """
    m, keep = slow.shape[0], 1.0 - min(0.5, period / MEMORY_S)
    x, y, turn = g[0], g[1], g[2]
    for i in range(m):
        a, b, c = weight[0] * x[i], weight[1] * y[i], weight[2] * turn[i]
        for k in range(m):
            slow[i, k] = keep * slow[i, k] + (a * x[k] + b * y[k] + c * turn[k])
        slow[i, m] = keep * slow[i, m] + (a * error[0] + b * error[1] + c * error[2])


@compiled
def resolve(slow, sure, off, sigma):
    """Write each jet's deviation from the thrust that is assumed, as a share of it, and its sigma.

    Args:
        slow: see `learn`.
        sure: 1 / tolerance^2 of z, shape (m,); of a jet's thrust SPREAD counts instead.
        off: shape (jets,).
        sigma: shape (jets,).
    """
    m, n = slow.shape[0], off.shape[0]
    root, inverse = scratch((m, m)), scratch((m, m))
    for i in range(m):
        for k in range(i + 1):
            total = slow[i, k]
            if i == k:
                total += 1.0 / SPREAD**2 if i < n else sure[i]
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
            known = 0.0
            for k in range(i + 1):
                known += inverse[i, k] * slow[k, m]
            off[j] += inverse[i, j] * known
        sigma[j] = min(SPREAD, np.sqrt(variance))
