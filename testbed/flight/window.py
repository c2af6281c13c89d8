"""A window of looks: how well each cause explains the residuals in it, and the best ones.

See the first lines of `jet_faults` for the arithmetic.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.compiled import borrowed, compiled, keep
from testbed.flight.hypotheses import KINDS, LEAK, WEAK, score
from testbed.flight.record import Kind, record

Array = NDArray[np.float64]

BLOCKS = 25
BEGUN = (1, 2, 3, 4, 5, 7, 10, 14, 24)  # tested beginnings [blocks ago]; the look is in block 0
WHITE = 2.6  # variance of the difference of two residuals, in variances of one
OUTLIER = 9.0  # variances: a larger residual in a look is not noise
MOST = 1.2  # largest leak of a jet, in multiples of its thrust

SUSPICION = record(  # the best of its kind
    jet=int,
    share=float,  # of the jet's thrust
    gain=float,  # in log-likelihood; 0: no suspicion
    next=float,  # gain of the next best jet
)

VERDICT: dict[str, Kind] = {
    "leak": SUSPICION,
    "weak": SUSPICION,
    "gains": (KINDS,),  # of the best cause of each kind, see hypotheses.py
    "sizes": (KINDS,),
    "way": (2,),  # of a pull in W
}


class Window(NamedTuple):
    """What was heard, changed in place."""

    told: Array  # z'z, and z'e as the last column, (m, m + 1)
    blocks: Array  # of jets, leaks, causes: x'z, x'x, x'e, (BLOCKS, m + 2, 2 n + COLUMNS)
    spread: Array  # variance of the residual, push and turn, (2,)
    last: Array  # previous residual, (3,)


@compiled
def clear(window):
    """Forget what was heard; how noisy it is stays known."""
    window.told[:], window.blocks[:], window.last[:] = 0.0, 0.0, 0.0


@compiled
def age(blocks):
    """Begin a block: the oldest two become one."""
    blocks[-2] += blocks[-1]
    blocks[1:] = blocks[:-1].copy()
    blocks[0] = 0.0


@compiled
def listen(window, e, x, trust, keep, rough, white):
    """Update noise and the correlations of e with its possible causes, in place.

    `white` is the variance of the difference of two residuals, in variances of one.
    """
    spread, last, told, blocks = window.spread, window.last, window.told, window.blocks
    m = told.shape[0]
    n = m - 4
    dx, dy, turn = e[0] - last[0], e[1] - last[1], e[2] - last[2]
    push = 0.5 * (dx * dx + dy * dy) / white
    spread[0] += trust * (min(push, OUTLIER * spread[0]) - spread[0])
    spread[1] += trust * (min(turn * turn / white, OUTLIER * spread[1]) - spread[1])
    last[:] = e
    push = 1.0 / (spread[0] + rough)
    weight = (push, push, 1.0 / spread[1])
    told *= keep
    blocks *= keep
    for i in range(x.shape[0]):
        a, b, c = x[i, 0] * weight[0], x[i, 1] * weight[1], x[i, 2] * weight[2]
        explains = a * e[0] + b * e[1] + c * e[2]
        if i < m:
            told[i, m] += explains
            for k in range(m):
                told[i, k] += a * x[k, 0] + b * x[k, 1] + c * x[k, 2]
        if i < n or i >= m:  # possible suspicions: jets, leaks, other causes
            h = i if i < n else i - 4
            for k in range(m):
                blocks[0, k, h] += a * x[k, 0] + b * x[k, 1] + c * x[k, 2]
            blocks[0, m, h] += a * x[i, 0] + b * x[i, 1] + c * x[i, 2]
            blocks[0, m + 1, h] += explains


@compiled
def factor(told, sure, slope):
    """L of z'z + 1 / tolerances^2, with 1 / L_ii in its diagonal, (m, m), and L^-1 z'e, (m,).

    Args:
        told: see Window.
        sure: 1 / tolerance^2 of z, (m,).
        slope: the same of the slope, the last two of z.
    """
    m = told.shape[0]
    least, y = np.zeros((m, m)), np.empty(m)
    for i in range(m):
        for k in range(i + 1):
            total = told[i, k]
            if i == k:
                total += slope if i >= m - 2 else sure[i]
            for q in range(k):
                total -= least[i, q] * least[k, q]
            least[i, k] = 1.0 / np.sqrt(total) if i == k else total * least[k, k]
        total = told[i, m]
        for q in range(i):
            total -= least[i, q] * y[q]
        y[i] = total * least[i, i]
    return least, y


@compiled
def suspect(since, least, y, root, fits, own):
    """Write S_j and N_j of jet_faults' first lines for every suspicion to `fits` and `own`.

    They are computed side by side: a processor does several at a time, and one after the other they
    took most of a tick.

    Args:
        since: columns x'z, x'x, x'e, one for each suspicion, shape (m + 2, count).
        least: see `factor`.
        y: see `factor`.
        root: working memory, shape (m, count).
        fits: shape (count,).
        own: shape (count,).
    """
    m, count = y.shape[0], since.shape[1]
    for h in range(count):
        own[h], fits[h] = since[m, h], since[m + 1, h]
    for i in range(m):
        for h in range(count):
            root[i, h] = since[i, h]
        for q in range(i):
            for h in range(count):
                root[i, h] -= least[i, q] * root[q, h]
        for h in range(count):
            root[i, h] *= least[i, i]
            own[h] -= root[i, h] * root[i, h]
            fits[h] -= root[i, h] * y[i]


@compiled
def decide(window, least, y, period, every, found):
    """Write the best cause of each kind to `found`, a record of VERDICT.

    Args:
        window: Window.
        least: see `factor`.
        y: see `factor`.
        period: of a look [s].
        every: whether to test every beginning, not those of BEGUN only.
        found: changed in place.
    """
    blocks, n = window.blocks, window.told.shape[0] - 4
    m, count = y.shape[0], blocks.shape[2]
    sums, memory, both = np.zeros((m + 2, count)), np.empty((m, count)), np.empty((2, count))
    since, root, fits, own = borrowed((sums, memory, both[0], both[1]))
    for k in range(blocks.shape[0]):
        since += blocks[k]
        if not (every or k in BEGUN):
            continue
        suspect(since, least, y, root, fits, own)
        for h in range(2 * n):
            if own[h] <= 1e-6 * since[-2, h] or own[h] < 1e-9:
                continue
            one, low, high = (found.weak, -1.0, 0.0) if h < n else (found.leak, 0.0, MOST)
            share = min(max(fits[h] / own[h], low), high)
            gain = share * fits[h] - 0.5 * share * share * own[h]
            if gain > one.gain:
                if one.jet != h % n:
                    one.next = one.gain
                one.jet, one.share, one.gain = h % n, abs(share), gain
            elif gain > one.next and one.jet != h % n:
                one.next = gain
        always = k == blocks.shape[0] - 1
        score(fits, own, 2 * n, period, always, found.gains, found.sizes, found.way)
    found.gains[LEAK], found.sizes[LEAK] = found.leak.gain, found.leak.share
    found.gains[WEAK], found.sizes[WEAK] = found.weak.gain, found.weak.share
    keep((sums, memory, both))


@compiled
def forget(found):
    """Suspect nothing."""
    found.leak.jet, found.leak.share, found.leak.gain, found.leak.next = 0, 0.0, 0.0, 0.0
    found.weak.jet, found.weak.share, found.weak.gain, found.weak.next = 0, 0.0, 0.0, 0.0
    found.gains[:] = found.sizes[:] = found.way[:] = 0.0
