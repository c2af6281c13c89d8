"""A window of looks: how well each cause explains the residuals in it, and the best ones.

See the first lines of `jet_faults` for the arithmetic.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.compiled import compiled, inlined
from testbed.core.scratch import scratch
from testbed.flight.hypotheses import COLUMNS, KINDS, LEAK, WEAK, score
from testbed.flight.record import Kind, record

Array = NDArray[np.float64]

SHARED = 5  # of z, after the jets: centre of mass x, y; torque; slope x, y
BLOCKS = 25
BEGUN = (1, 2, 3, 4, 5, 7, 10, 14, 24)  # tested beginnings [blocks ago]; the look is in block 0
WHITE = 2.6  # variance of the difference of two residuals, in variances of one
OUTLIER = 9.0  # variances: a larger residual in a look is not noise
SIDE_BY_SIDE = 16  # columns that a processor's loop takes at once; a rest is taken one by one
MOST = 1.2  # largest leak of a jet, in multiples of its thrust

SUSPICION = record(  # the best of its kind
    jet=int,
    share=float,  # of the jet's thrust
    gain=float,  # in log-likelihood; 0: no suspicion
    next=float,  # gain of the next best jet
    other=int,  # that jet
)

VERDICT: dict[str, Kind] = {
    "leak": SUSPICION,
    "weak": SUSPICION,
    "gains": (KINDS,),  # of the best cause of each kind, see hypotheses.py
    "sizes": (KINDS,),
    "way": (2,),  # of a pull in W
}


class Window(NamedTuple):
    """Sums of the looks, changed in place."""

    normal: Array  # z'z, and z'e as the last column, (m, m + 1)
    blocks: Array  # of jets, leaks, causes: x'z, x'x, x'e, (BLOCKS, m + 2, width_of(n)), a ring
    worth: Array  # what is not forgotten of each block since it was the newest, (BLOCKS,)
    newest: Array  # place of the newest block, (1,)
    spread: Array  # variance of the residual, push and turn, (2,)
    last: Array  # previous residual, (3,)


def width_of(jets: int) -> int:
    """Columns of a window's blocks: of each jet, its leak and the other causes; the last are 0."""
    return -(-(2 * jets + COLUMNS) // SIDE_BY_SIDE) * SIDE_BY_SIDE


@compiled
def clear(window):
    """Forget the looks; how noisy they are stays known."""
    window.normal[:], window.blocks[:], window.last[:] = 0.0, 0.0, 0.0


@compiled
def age(window, began):
    """Begin a block: the oldest two become one.

    If the best cause began between these, the second becomes one with the third: before it began it
    pushed nothing, and without its beginning a cause that has always been there would explain more.

    Args:
        window: Window, changed in place.
        began: block of the best cause's beginning, see `decide`.
    """
    blocks, worth, count = window.blocks, window.worth, window.worth.shape[0]
    oldest = (int(window.newest[0]) + count - 1) % count
    second, third = (oldest + count - 1) % count, (oldest + count - 2) % count
    if began == count - 2:
        blocks[third] = worth[third] * blocks[third] + worth[second] * blocks[second]
        blocks[second], worth[third], worth[second] = blocks[oldest], 1.0, worth[oldest]
    else:
        blocks[second] = worth[second] * blocks[second] + worth[oldest] * blocks[oldest]
        worth[second] = 1.0
    blocks[oldest], window.newest[0] = 0.0, oldest


@compiled
def listen(window, x, trust, keep, rough, white):
    """Update noise and the correlations of residuals with their possible causes, in place.

    Args:
        window: Window.
        x: causes, and the residual as the last column, see `jet_faults.residual`.
        trust: weight of this look in the estimate of the noise.
        keep: factor of forgetting.
        rough: see jet_faults.Known.
        white: variance of the difference of two residuals, in variances of one.
    """
    spread, last, normal = window.spread, window.last, window.normal
    worth, now = window.worth, int(window.newest[0])
    block, m, rows = window.blocks[now], normal.shape[0], x.shape[1] - 1
    n, e = m - SHARED, (x[0, rows], x[1, rows], x[2, rows])
    dx, dy, turn = e[0] - last[0], e[1] - last[1], e[2] - last[2]
    push = 0.5 * (dx * dx + dy * dy) / white
    spread[0] += trust * (min(push, OUTLIER * spread[0]) - spread[0])
    spread[1] += trust * (min(turn * turn / white, OUTLIER * spread[1]) - spread[1])
    last[0], last[1], last[2] = e
    push, spun = 1.0 / (spread[0] + rough), 1.0 / spread[1]
    worth *= keep  # older blocks are not touched
    worth[now] = 1.0
    for k in range(m):
        a, b, c = x[0, k] * push, x[1, k] * push, x[2, k] * spun
        for i in range(m):
            normal[k, i] = keep * normal[k, i] + (a * x[0, i] + b * x[1, i] + c * x[2, i])
        normal[k, m] = keep * normal[k, m] + (a * e[0] + b * e[1] + c * e[2])
        for i in range(n):  # possible suspicions: jets, leaks, other causes
            block[k, i] = keep * block[k, i] + (a * x[0, i] + b * x[1, i] + c * x[2, i])
        for i in range(m, rows):
            h = i - SHARED
            block[k, h] = keep * block[k, h] + (a * x[0, i] + b * x[1, i] + c * x[2, i])
    for h in range(rows - SHARED):
        i = h if h < n else h + SHARED
        a, b, c = x[0, i] * push, x[1, i] * push, x[2, i] * spun
        block[m, h] = keep * block[m, h] + (a * x[0, i] + b * x[1, i] + c * x[2, i])
        block[m + 1, h] = keep * block[m + 1, h] + (a * e[0] + b * e[1] + c * e[2])


@compiled
def factor(normal, sure, slope, least, y):
    """Write L^-1 of z'z + 1 / tolerances^2 to `least`, (m, m), and L^-1 z'e to `y`, (m,).

    Args:
        normal: see Window.
        sure: 1 / tolerance^2 of z, (m,).
        slope: the same of the slope, the last two of z.
        least: written.
        y: written.
    """
    m = normal.shape[0]
    root = scratch((m, m))
    least[:], y[:] = 0.0, 0.0
    for i in range(m):
        for k in range(i + 1):
            total = normal[i, k]
            if i == k:
                total += slope if i >= m - 2 else sure[i]
            for q in range(k):
                total -= root[i, q] * root[k, q]
            root[i, k] = 1.0 / np.sqrt(total) if i == k else total * root[k, k]
        least[i, i] = root[i, i]
        for h in range(i):
            total = 0.0
            for q in range(h, i):
                total -= root[i, q] * least[q, h]
            least[i, h] = total * root[i, i]
        for q in range(i + 1):
            y[i] += least[i, q] * normal[q, m]


@inlined
def add_product(least, i, q, since, parts):
    """Add what rows q to q + 3 of `since` give in rows i to i + 3 of L^-1 z'x, see `suspect`."""
    one, two, three, four = since[q], since[q + 1], since[q + 2], since[q + 3]
    p0, p1, p2, p3 = parts[0], parts[1], parts[2], parts[3]
    a0, a1, a2, a3 = least[i, q], least[i, q + 1], least[i, q + 2], least[i, q + 3]
    i += 1
    b0, b1, b2, b3 = least[i, q], least[i, q + 1], least[i, q + 2], least[i, q + 3]
    i += 1
    c0, c1, c2, c3 = least[i, q], least[i, q + 1], least[i, q + 2], least[i, q + 3]
    i += 1
    d0, d1, d2, d3 = least[i, q], least[i, q + 1], least[i, q + 2], least[i, q + 3]
    for h in range(since.shape[1]):
        a, b, c, d = one[h], two[h], three[h], four[h]
        p0[h] += a0 * a + a1 * b + a2 * c + a3 * d
        p1[h] += b0 * a + b1 * b + b2 * c + b3 * d
        p2[h] += c0 * a + c1 * b + c2 * c + c3 * d
        p3[h] += d0 * a + d1 * b + d2 * c + d3 * d


@compiled
def suspect(since, least, y, parts, fits, own):
    """Write S_j and N_j of jet_faults' first lines for every suspicion to `fits` and `own`.

    They are computed side by side, and four rows of L^-1 z'x from four of z'x at a time: a
    processor does several columns at a time and seldom waits for memory. One suspicion after the
    other, they took most of a tick.

    Args:
        since: columns x'z, x'x, x'e, one for each suspicion, shape (m + 2, count).
        least: see `factor`.
        y: see `factor`.
        parts: working memory, shape (4, count).
        fits: shape (count,).
        own: shape (count,).
    """
    m, count = y.shape[0], since.shape[1]
    by_fours = m - m % 4
    p0, p1, p2, p3 = parts[0], parts[1], parts[2], parts[3]
    for h in range(count):
        own[h], fits[h] = since[m, h], since[m + 1, h]
    for i in range(0, by_fours, 4):
        parts[:] = 0.0
        for q in range(0, i + 4, 4):
            add_product(least, i, q, since, parts)
        y0, y1, y2, y3 = y[i], y[i + 1], y[i + 2], y[i + 3]
        for h in range(count):
            own[h] -= p0[h] * p0[h] + p1[h] * p1[h] + p2[h] * p2[h] + p3[h] * p3[h]
            fits[h] -= y0 * p0[h] + y1 * p1[h] + y2 * p2[h] + y3 * p3[h]
    for i in range(by_fours, m):
        p0[:] = 0.0
        for q in range(i + 1):
            for h in range(count):
                p0[h] += least[i, q] * since[q, h]
        for h in range(count):
            own[h] -= p0[h] * p0[h]
            fits[h] -= y[i] * p0[h]


@compiled
def suspect_jets(squares, fits, own, n, found):
    """Keep the best suspicions of a leak and of a weak jet.

    Args:
        squares: x'x of each, (count,).
        fits: see `suspect`.
        own: the same.
        n: jets; the first columns are weak ones, the next leaks.
        found: a record of VERDICT, changed in place.
    """
    for h in range(2 * n):
        if own[h] <= 1e-6 * squares[h] or own[h] < 1e-9:
            continue
        one, low, high = (found.weak, -1.0, 0.0) if h < n else (found.leak, 0.0, MOST)
        share = min(max(fits[h] / own[h], low), high)
        gain = share * fits[h] - 0.5 * share * share * own[h]
        if gain > one.gain:
            if one.jet != h % n:
                one.next, one.other = one.gain, one.jet
            one.jet, one.share, one.gain = h % n, abs(share), gain
        elif gain > one.next and one.jet != h % n:
            one.next, one.other = gain, h % n


@compiled
def decide(window, least, y, period, twist, every, found):
    """Write the best cause of each kind to `found`, a record of VERDICT.

    Returns the block, counted from the newest one, in which the best of all of them began.

    Args:
        window: Window.
        least: see `factor`.
        y: see `factor`.
        period: of a look [s].
        twist: largest turn by a hose [rad/s^2].
        every: whether to test every beginning, not those of BEGUN only.
        found: changed in place.
    """
    blocks, worth, now = window.blocks, window.worth, int(window.newest[0])
    m, n, count = y.shape[0], y.shape[0] - SHARED, blocks.shape[2]
    since, parts = scratch((m + 2, count)), scratch((4, count))
    fits, own = scratch(count), scratch(count)
    since[:] = 0.0
    began, best = 0, 0.0
    for k in range(blocks.shape[0]):
        place = (now + k) % blocks.shape[0]
        block, left = blocks[place], worth[place]
        for i in range(m + 2):  # as an expression of arrays it takes four times as long
            for h in range(count):
                since[i, h] += left * block[i, h]
        if not (every or k in BEGUN):
            continue
        suspect(since, least, y, parts, fits, own)
        suspect_jets(since[m], fits, own, n, found)
        start = k == blocks.shape[0] - 1
        score(fits, own, 2 * n, period, twist, start, found.gains, found.sizes, found.way)
        gain = max(found.leak.gain, found.weak.gain, found.gains.max())
        if gain > best:
            began, best = k, gain
    found.gains[LEAK], found.sizes[LEAK] = found.leak.gain, found.leak.share
    found.gains[WEAK], found.sizes[WEAK] = found.weak.gain, found.weak.share
    return began


@compiled
def forget(found):
    """Suspect nothing."""
    for one in (found.leak, found.weak):
        one.jet, one.share, one.gain, one.next, one.other = 0, 0.0, 0.0, 0.0, 0
    found.gains[:] = found.sizes[:] = found.way[:] = 0.0
