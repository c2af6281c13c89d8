"""The sums of a regression of innovations on the causes, and what they say; see `innovations`.

A cause may begin at any time. The last RECENT of such times are tested, older ones at distances
that double into the past, and the start.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.compiled import borrowed, compiled, keep
from testbed.flight.hypotheses import LEAK, WEAK, score
from testbed.flight.window import factor, forget, suspect, suspect_jets, width_of

Array = NDArray[np.float64]

RECENT = 10  # beginnings that are tested one after the other
BEGINNINGS = RECENT + 9
BELIEVED = 30.0  # weight of the files' noise at the start [looks]
LIKELY = 9.2  # gain that counts if it lasts: 4.3 sigma
WEIGHED = 2  # looks from one verdict to the next


class Sums(NamedTuple):
    """Sums over time, changed in place."""

    gives: Array  # what each jet gives of its commands, as the filter believes, (n,)
    leaks: Array  # and without one, (n,)
    ways: Array  # of each jet, over the poses of this look: integral of its impulse, (n,) [s^2]
    sure: Array  # what an uncertain parameter changes in x of each axis, (3, 3, m)
    moved: Array  # the same of causes, by beginning, (BEGINNINGS, 3, 3, count)
    told: Array  # z'z, and z'e as the last column, (m, m + 1)
    blocks: Array  # x'z, x'x, x'e of causes, by beginning, (BEGINNINGS, m + 2, count)


def shapes_of(jets: int) -> list[tuple[int, ...]]:
    """Shapes of `Sums`."""
    m, count = 2 * jets + 3, width_of(jets)
    return [
        (jets,), (jets,), (jets,), (3, 3, m), (BEGINNINGS, 3, 3, count), (m, m + 1),
        (BEGINNINGS, m + 2, count),
    ]  # fmt: skip


@compiled
def add(sums, axis, acts, sees, steps, gain, error, weight, x):
    """Add an innovation to the sums, and let each cause change the filter as it would.

    Args:
        sums: Sums, changed in place.
        axis: of the innovation.
        acts: what each parameter and cause gives in velocity, way and mean pose, (3, columns).
        sees: how velocity and acceleration at the beginning show in the mean pose.
        steps: see `coasts`.
        gain: of the filter.
        error: the innovation.
        weight: 1 / its variance; 0: it does not count.
        x: working memory, (2, columns).
    """
    z = sums.told.shape[0]
    g, x = x[0, :z], x[1, z:]
    respond(sums.sure[axis], acts[0, :z], acts[1, :z], acts[2, :z], sees, steps, gain, g)
    for i in range(z):
        a = weight * g[i]
        for k in range(z):
            sums.told[i, k] += a * g[k]
        sums.told[i, z] += a * error
    speeds, ways, shows = acts[0, z:], acts[1, z:], acts[2, z:]
    for b in range(BEGINNINGS):
        block = sums.blocks[b]
        respond(sums.moved[b, axis], speeds, ways, shows, sees, steps, gain, x)
        for k in range(z):
            a = weight * g[k]
            for i in range(x.shape[0]):
                block[k, i] += a * x[i]
        for i in range(x.shape[0]):
            a = weight * x[i]
            block[z, i] += a * x[i]
            block[z + 1, i] += a * error


@compiled
def respond(moved, speeds, ways, shows, sees, steps, gain, x):
    """Write to `x` what each column changes in the innovation, and advance what it changes.

    In short loops over rows: a processor does several columns at a time.

    Args:
        moved: position, velocity and acceleration of the filter without poses, (3, count).
        speeds: what each column gives in velocity, (count,).
        ways: in way.
        shows: in the mean pose.
        sees: see `add`.
        steps: the same.
        gain: the same.
        x: (count,).
    """
    (one, two), (stays, moves, drifts) = sees, steps
    position, velocity, slope = moved[0], moved[1], moved[2]
    of_position, of_velocity, of_slope = gain
    for i in range(x.shape[0]):
        x[i] = position[i] + one * velocity[i] + two * slope[i] + shows[i]
    for i in range(x.shape[0]):
        velocity[i] -= of_velocity * x[i]
        slope[i] -= of_slope * x[i]
    for i in range(x.shape[0]):
        position[i] += moves * velocity[i] + drifts * slope[i] + ways[i] - of_position * x[i]
    for i in range(x.shape[0]):
        velocity[i] = stays * velocity[i] + moves * slope[i] + speeds[i]


@compiled
def age(p, m, sums):
    """Let a beginning begin here; the ruler sequence decides which older one it takes the place of.

    The beginning of the best cause stays.
    """
    if m.looks % p.next != 0:
        return
    sums.told[:] *= p.keep
    sums.blocks[:] *= p.keep
    m.heard, m.squares = p.keep * m.heard, p.keep * m.squares
    count, old = m.looks // p.next, RECENT
    fresh = count % RECENT
    while count % 2 == 0 and old < BEGINNINGS - 2:
        count, old = count // 2, old + 1
    if old != m.began:
        sums.moved[old], sums.blocks[old] = sums.moved[fresh], sums.blocks[fresh]
        if m.began == fresh:
            m.began = old
    sums.moved[fresh], sums.blocks[fresh] = 0.0, 0.0


@compiled
def weigh(p, m, sums):
    """Write what the innovations say to `m`, a record of VERDICT."""
    z, columns = sums.told.shape[0], sums.blocks.shape[2]
    n, weak, leak = (z - 3) // 2, m.weak.jet, m.leak.jet
    forget(m)
    sure = 1.0 / max(1.0, m.noise)
    root = factor(sure * sums.told, p.sure, p.sure[z - 1])
    least, y = borrowed(root)
    memory = np.empty((6 + z + 2, columns))
    parts, fits, own, block = borrowed((memory[:4], memory[4], memory[5], memory[6:]))
    most, m.began = 0.0, BEGINNINGS - 1
    for b in range(BEGINNINGS):
        for i in range(z + 2):
            for h in range(columns):
                block[i, h] = sure * sums.blocks[b, i, h]
        suspect(block, least, y, parts, fits, own)
        suspect_jets(block[z], fits, own, n, m)
        score(fits, own, 2 * n, p.period, b == BEGINNINGS - 1, m.gains, m.sizes, m.way)
        gain = max(m.leak.gain, m.weak.gain, m.gains.max())
        if gain > most:
            most, m.began = gain, b
    likely = m.weak.gain > LIKELY and m.weak.jet == weak
    m.held = m.held + WEIGHED if likely else 0
    m.leaks = m.leaks + 1 if m.leak.gain > LIKELY and m.leak.jet == leak else 0
    m.gains[LEAK], m.sizes[LEAK] = m.leak.gain, m.leak.share
    m.gains[WEAK], m.sizes[WEAK] = m.weak.gain, m.weak.share
    left = max(0.0, sure * m.squares - (y * y).sum() - 2.0 * most) / sure
    m.noise = max(1.0, (BELIEVED + left) / (BELIEVED + m.heard))
    keep((root, memory))
