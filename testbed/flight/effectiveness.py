"""What each jet really gives: a slow estimate in flight, beside the detector of faults.

Least squares over the same looks as `jet_faults`, with a memory of minutes: the residual momentum
is explained by the thrust of every jet, the centre of mass and the slope together. The estimate is
shown and flown by nothing: a vehicle with healthy jets flies as its file says.
"""

import numpy as np

from testbed.core.compiled import compiled

MEMORY_S = 120.0  # time constant of forgetting [s]
SPREAD = 0.3  # of a jet's share before anything is heard of it, one sigma
MOST = 1.5  # largest share that is shown
WHITENESS = 2.0  # the residuals of successive looks depend on each other: sigmas are wider by this


@compiled
def learn(heard, e, x, period, rough):
    """Add a look to the sums, in place.

    Args:
        heard: jet_faults.Heard; `slow` has z'z, and z'e as the last column, shape (m, m + 1).
        e: residual, shape (3,), see jet_faults.residual.
        x: its possible causes, the first m are z.
        period: of a look [s].
        rough: see jet_faults.Known.
    """
    slow, m, spread = heard.slow, heard.slow.shape[0], heard.near.spread
    push = 1.0 / (spread[0] + rough)
    weights = (push, push, 1.0 / spread[1])
    slow *= 1.0 - min(0.5, period / MEMORY_S)
    for i in range(m):
        a, b, c = x[i, 0] * weights[0], x[i, 1] * weights[1], x[i, 2] * weights[2]
        for k in range(m):
            slow[i, k] += a * x[k, 0] + b * x[k, 1] + c * x[k, 2]
        slow[i, m] += a * e[0] + b * e[1] + c * e[2]


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
    root, inverse = np.zeros((m, m)), np.zeros((m, m))
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
