"""The regression of innovations on the causes, and what it says; see `innovations`.

An innovation is e = g'z + x b + noise, with the uncertain parameters z and the size b of one cause.
The best z is learned in passing, one innovation after the other (recursive least squares). A cause
would change it, by r for a size of 1, so what it leaves unexplained for z is x - g'r. With s the
variance of e - g'z, each cause has its own sums

    N = sum of (x - g'r)^2 / s         S = sum of (x - g'r) (e - g'z) / s

as in the first lines of `jet_faults`, without its L: z is already taken out.

A cause may begin at any time. The last RECENT of such times are tested, older ones at distances
that double into the past, and the start. What it changes if it begins at b is what it changes since
the start, without what it had changed until b: that only fades, as the filter forgets an error of
its state.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.compiled import compiled
from testbed.core.scratch import scratch
from testbed.flight.hypotheses import LEAK, WEAK, score
from testbed.flight.window import forget, suspect_jets, width_of

Array = NDArray[np.float64]

RECENT = 6  # beginnings that are tested one after the other
BEGINNINGS = RECENT + 9  # up to 26 s ago, and the start
BELIEVED = 30.0  # weight of the files' noise at the start [looks]
LIKELY = 9.2  # gain that counts if it lasts: 4.3 sigma
FORGETS = 10  # looks from one forgetting to the next


class Sums(NamedTuple):
    """Sums over time, changed in place."""

    gives: Array  # what each jet gives of its commands, as the filter believes, (n,)
    leaks: Array  # and without one, (n,)
    ways: Array  # of each jet, over the poses of this look: integral of its impulse, (n,) [s^2]
    sure: Array  # what an uncertain parameter changes in x of each axis, (3, 3, m)
    moved: Array  # the same of causes since the start, (3, 3, count)
    before: Array  # `moved` at each beginning, (BEGINNINGS, 3, 3, count)
    fades: Array  # what a change of x, each number of it, then is now, (3, 3, 3 BEGINNINGS)
    z: Array  # uncertain parameters, (m,)
    cov: Array  # their covariance, (m, m)
    changed: Array  # r of causes, by beginning, (BEGINNINGS, m, count)
    scores: Array  # N and S of causes, by beginning, (BEGINNINGS, 2, count)
    slow: Array  # see effectiveness.py, (m, m + 1)


def shapes_of(jets: int) -> list[tuple[int, ...]]:
    """Shapes of `Sums`."""
    m, count = 2 * jets + 3, width_of(jets)
    return [
        (jets,), (jets,), (jets,), (3, 3, m), (3, 3, count), (BEGINNINGS, 3, 3, count),
        (3, 3, 3 * BEGINNINGS), (m,), (m, m), (BEGINNINGS, m, count), (BEGINNINGS, 2, count),
        (m, m + 1),
    ]  # fmt: skip


@compiled
def clear(p, sums):
    """Forget all innovations."""
    sums.sure[:], sums.moved[:], sums.before[:], sums.fades[:] = 0.0, 0.0, 0.0, 0.0
    sums.changed[:], sums.scores[:], sums.z[:], sums.cov[:] = 0.0, 0.0, 0.0, 0.0
    sums.slow[:] = 0.0
    for i in range(p.sure.shape[0]):
        sums.cov[i, i] = 1.0 / p.sure[i]


class Look(NamedTuple):
    """The mean pose's innovations of three axes, and how the filter and z follow them."""

    sees: Array  # how velocity and acceleration at the beginning show in the mean pose, (3, 2)
    steps: Array  # see innovations.coasts, (3, 3)
    gain: Array  # of the filter, (3, 3)
    g: Array  # of z, (3, m)
    gain_z: Array  # change of z by a unit of what is left, (3, m)
    left: Array  # what z leaves of the innovation, (3,)
    weight: Array  # 1 / variance of that, (3,)


@compiled
def learn(sums, seen, axis, acts, error, noise):
    """Learn the uncertain parameters from an innovation; write to the last four of `seen`.

    Args:
        sums: Sums, changed in place.
        seen: Look, changed in place.
        axis: of the innovation.
        acts: what each parameter and cause gives in velocity, way and mean pose, (3, columns).
        error: the innovation.
        noise: its variance; infinite: it does not count.
    """
    m, z, cov = sums.z.shape[0], sums.z, sums.cov
    g, gain = seen.g[axis], seen.gain_z[axis]
    respond(sums.sure[axis], acts[0, :m], acts[1, :m], acts[2, :m], seen, axis, g)
    variance, left = noise, error
    for i in range(m):
        gain[i] = 0.0
        for h in range(m):
            gain[i] += cov[i, h] * g[h]
        variance += g[i] * gain[i]
        left -= g[i] * z[i]
    weight = 1.0 / variance
    for i in range(m):
        for h in range(m):
            cov[i, h] -= weight * gain[i] * gain[h]
    for i in range(m):
        gain[i] *= weight
        z[i] += gain[i] * left
    seen.left[axis], seen.weight[axis] = left, weight


@compiled
def add(sums, seen, acts):
    """Add a look to the sums of each cause, and let the cause change filter and parameters.

    The three axes are learned from one after the other, but in one pass: what the first two have
    changed is taken out of the others.

    Args:
        sums: Sums, changed in place.
        seen: Look.
        acts: of each axis, see `learn`, (3, 3, columns).
    """
    m, count, weight = sums.z.shape[0], sums.scores.shape[2], seen.weight
    since_start = scratch((3, count))
    x0, x1, x2 = scratch(count), scratch(count), scratch(count)
    fades, nothing = scratch((3, 3 * BEGINNINGS)), scratch(3 * BEGINNINGS)
    nothing[:] = 0.0
    for axis in range(3):
        act = acts[axis]
        speeds, ways, shows = act[0, m:], act[1, m:], act[2, m:]
        respond(sums.moved[axis], speeds, ways, shows, seen, axis, since_start[axis])
        respond(sums.fades[axis], nothing, nothing, nothing, seen, axis, fades[axis])
    first = second = both = 0.0  # what axis 0 changes in 1, in 2, and 1 in 2
    for q in range(m):
        first += seen.g[1, q] * seen.gain_z[0, q]
        second += seen.g[2, q] * seen.gain_z[0, q]
        both += seen.g[2, q] * seen.gain_z[1, q]
    w0, w1, w2 = weight[0], weight[1], weight[2]
    e0, e1, e2 = w0 * seen.left[0], w1 * seen.left[1], w2 * seen.left[2]
    for b in range(BEGINNINGS):
        own, fits = sums.scores[b, 0], sums.scores[b, 1]
        subtract(since_start[0], fades[0, 3 * b :], sums.before[b, 0], x0)
        subtract(since_start[1], fades[1, 3 * b :], sums.before[b, 1], x1)
        subtract(since_start[2], fades[2, 3 * b :], sums.before[b, 2], x2)
        take_out(sums.changed[b], seen.g, x0, x1, x2)
        for i in range(count):
            x1[i] -= first * x0[i]
            x2[i] -= second * x0[i] + both * x1[i]
        for i in range(count):
            own[i] += w0 * x0[i] * x0[i] + w1 * x1[i] * x1[i] + w2 * x2[i] * x2[i]
        for i in range(count):
            fits[i] += e0 * x0[i] + e1 * x1[i] + e2 * x2[i]
        change(sums.changed[b], seen.gain_z, x0, x1, x2)


@compiled
def subtract(whole, fades, before, x):
    """Write to `x` what is left of `whole` without what fades of `before`, (3, count)."""
    f0, f1, f2 = fades[0], fades[1], fades[2]
    for i in range(x.shape[0]):
        x[i] = whole[i] - (f0 * before[0, i] + f1 * before[1, i] + f2 * before[2, i])


@compiled
def take_out(changed, g, x0, x1, x2):
    """Take out of x what the parameters explain of it, g'r; four of them at a time."""
    m, count = changed.shape
    for q in range(0, m - m % 4, 4):
        a0, a1, a2, a3 = g[0, q], g[0, q + 1], g[0, q + 2], g[0, q + 3]
        b0, b1, b2, b3 = g[1, q], g[1, q + 1], g[1, q + 2], g[1, q + 3]
        c0, c1, c2, c3 = g[2, q], g[2, q + 1], g[2, q + 2], g[2, q + 3]
        r0, r1, r2, r3 = changed[q], changed[q + 1], changed[q + 2], changed[q + 3]
        for i in range(count):
            x0[i] -= a0 * r0[i] + a1 * r1[i] + a2 * r2[i] + a3 * r3[i]
            x1[i] -= b0 * r0[i] + b1 * r1[i] + b2 * r2[i] + b3 * r3[i]
            x2[i] -= c0 * r0[i] + c1 * r1[i] + c2 * r2[i] + c3 * r3[i]
    for q in range(m - m % 4, m):
        r0, a0, b0, c0 = changed[q], g[0, q], g[1, q], g[2, q]
        for i in range(count):
            x0[i] -= a0 * r0[i]
            x1[i] -= b0 * r0[i]
            x2[i] -= c0 * r0[i]


@compiled
def change(changed, gain, x0, x1, x2):
    """Let the parameters follow what is left of x."""
    m, count = changed.shape
    for q in range(m):
        r, a, b, c = changed[q], gain[0, q], gain[1, q], gain[2, q]
        for i in range(count):
            r[i] += a * x0[i] + b * x1[i] + c * x2[i]


@compiled
def respond(moved, speeds, ways, shows, seen, axis, x):
    """Write to `x` what each column changes in the innovation, and advance what it changes.

    In short loops over rows: a processor does several columns at a time.

    Args:
        moved: position, velocity and acceleration of the filter without poses, (3, count).
        speeds: what each column gives in velocity, (count,).
        ways: in way.
        shows: in the mean pose.
        seen: Look.
        axis: of it.
        x: (count,).
    """
    one, two = seen.sees[axis, 0], seen.sees[axis, 1]
    stays, moves, drifts = seen.steps[axis, 0], seen.steps[axis, 1], seen.steps[axis, 2]
    position, velocity, slope = moved[0], moved[1], moved[2]
    of_position, of_velocity = seen.gain[axis, 0], seen.gain[axis, 1]
    of_slope = seen.gain[axis, 2]
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
    if m.looks % FORGETS == 0:
        fade(p, m, sums)
    count, old = m.looks, RECENT
    fresh = count % RECENT
    while count % 2 == 0 and old < BEGINNINGS - 2:
        count, old = count // 2, old + 1
    if old != m.began:
        sums.before[old], sums.changed[old] = sums.before[fresh], sums.changed[fresh]
        sums.scores[old] = sums.scores[fresh]
        sums.fades[:, :, 3 * old : 3 * old + 3] = sums.fades[:, :, 3 * fresh : 3 * fresh + 3]
        if m.began == fresh:
            m.began = old
    sums.before[fresh], sums.changed[fresh], sums.scores[fresh] = sums.moved, 0.0, 0.0
    for axis in range(3):
        for i in range(3):
            for k in range(3):
                sums.fades[axis, i, 3 * fresh + k] = 1.0 if i == k else 0.0


@compiled
def fade(p, m, sums):
    """Forget a little: the parameters return to the file's values, and may be others later."""
    sums.scores[:] *= p.keep
    m.remembered, m.squares = p.keep * m.remembered, p.keep * m.squares
    sums.z[:] *= p.stays
    sums.changed[:] *= p.stays
    sums.cov[:] *= p.stays * p.stays
    for i in range(p.sure.shape[0]):
        sums.cov[i, i] += (1.0 - p.stays * p.stays) / p.sure[i]


@compiled
def weigh(p, m, sums, flow):
    """Write what the innovations say to `m`, a record of VERDICT.

    Args:
        p: Known.
        m: innovations.MEMORY, changed in place.
        sums: Sums.
        flow: of each jet in this look, (n,) [s].
    """
    columns = sums.scores.shape[2]
    n, weak, leak = sums.ways.shape[0], m.weak.jet, m.leak.jet
    forget(m)
    sure = 1.0 / max(1.0, m.noise)
    own, fits = scratch(columns), scratch(columns)
    most, m.began = 0.0, BEGINNINGS - 1
    for b in range(BEGINNINGS):
        for h in range(columns):
            own[h], fits[h] = sure * sums.scores[b, 0, h], sure * sums.scores[b, 1, h]
        suspect_jets(own, fits, own, n, m)  # of x'x nothing is left but N
        start = b == BEGINNINGS - 1
        score(fits, own, 2 * n, p.period, p.twist, start, m.gains, m.sizes, m.way)
        gain = max(m.leak.gain, m.weak.gain, m.gains.max())
        if gain > most:
            most, m.began = gain, b
    likely = m.weak.gain > LIKELY and m.weak.jet == weak
    if not likely:
        m.held = 0
    elif flow[m.weak.jet] > 0.0:
        m.held += 1
    m.leak_held = m.leak_held + 1 if m.leak.gain > LIKELY and m.leak.jet == leak else 0
    m.gains[LEAK], m.sizes[LEAK] = m.leak.gain, m.leak.share
    m.gains[WEAK], m.sizes[WEAK] = m.weak.gain, m.weak.share
    left = max(0.0, m.squares - 2.0 * most / sure)
    m.noise = max(1.0, (BELIEVED + left) / (BELIEVED + m.remembered))
