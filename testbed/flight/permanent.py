"""Causes that have been there since the flight began, scored over the whole flight.

A file that is wrong, or cameras whose body is turned, push in every second that the jets fire. The
long window of `jet_faults` takes a part of such a push for noise, because its noise is the change
from one second to the next, and it forgets the start, where a vehicle pushes hardest. Here all
seconds have the same weight, none is forgotten, and the noise is what the best cause leaves of
the residuals. Only the first second says nothing: the estimator finds its velocity in it, and up
to 10 mm/s of that look like a push. See the first lines of `jet_faults` for the arithmetic.

The long window forgets when a hose began to pull, and then takes it for a wrong mass. So once it
was sure of a cause that began in flight, causes that were there before are refuted for good.
"""

from typing import Any

import numpy as np

from testbed.core.compiled import compiled, keep
from testbed.core.scratch import scratch
from testbed.flight import hypotheses
from testbed.flight.bad_jet import NEAR
from testbed.flight.hypotheses import (
    CLEAR,
    LATE,
    MASS,
    NUDGE,
    SHORT,
    SURE,
    THRUST,
    TURNED,
    WEAK,
    WORTH,
    better,
    beyond,
    certain,
)
from testbed.flight.jet_faults import SPIN_SPREAD, SPREAD
from testbed.flight.record import record
from testbed.flight.window import VERDICT, WHITE, Window, clear, decide, factor, forget, listen

KINDS = (THRUST, MASS, TURNED, LATE)  # that it names
NEVER_LATER = (THRUST, MASS, TURNED)  # causes that are tested since the start only
TURNS = (SPIN_SPREAD / SPREAD) ** 2  # variance of a turn, in variances of a push
LEAST_SUMS = 10  # before a heading is believed to be off: unequal jets look like it for a while
ROUGHLY = 0.25  # sizes of thrust or mass that differ by this share are the same
BELIEVED = 9.0  # weight of the spread at the start [residuals]

MEMORY = record(
    begun=int,  # 1: the first sum has passed; the estimator settles in it
    sums=int,  # so far, without that one
    squares=float,  # sum of the squared residuals, in those of a push [m^2/s^2]
    later=(hypotheses.KINDS,),  # 1: for this kind, the long window was sure of another cause
    noise=float,  # variance of a push; 0: none was heard [m^2/s^2]
    **VERDICT,
)


@compiled
def update(p, m, window, evidence, far):
    """Add the looks that the long window has summed, all but its last.

    Args:
        p: jet_faults.Known.
        m: MEMORY, changed in place.
        window: Window of one block, changed in place.
        evidence: jet_faults.Evidence.
        far: VERDICT of the long window.
    """
    if m.begun == 0:
        m.begun, m.noise = 1, SPREAD * SPREAD
        return
    window.spread[0], window.spread[1] = 1.0, TURNS
    sums = evidence.sums
    push_x, push_y, turn = sums[0, -1], sums[1, -1], sums[2, -1]
    listen(window, sums, 0.0, 1.0, 0.0, WHITE)
    m.sums += 1
    m.squares += push_x * push_x + push_y * push_y + turn * turn / TURNS
    sure = 1.0 / (m.noise + (p.long - 1) * p.rough)
    weighed = Window(
        window.normal * sure, window.blocks * sure, window.worth, window.newest, window.spread,
        window.last,
    )  # fmt: skip
    z, slope = p.sure.shape[0], p.bumps * p.bumps + p.slope * p.slope
    least, y = scratch((z, z)), scratch(z)
    factor(weighed.normal, p.sure, 1.0 / slope, least, y)
    forget(m)
    decide(weighed, least, y, p.period, p.twist, True, m)
    m.gains[NUDGE], m.sizes[NUDGE] = far.gains[NUDGE], far.sizes[NUDGE]
    best = max(m.gains[:NUDGE].max(), 0.0)
    left = max(0.0, sure * m.squares - (y * y).sum() - 2.0 * best) / sure
    m.noise = (BELIEVED * SPREAD * SPREAD + left) / (BELIEVED + 3.0 * m.sums)
    keep(weighed)


@compiled
def refute(m, far):
    """Note what the long window refutes, and take it out of its verdict.

    Args:
        m: MEMORY, changed in place.
        far: VERDICT of the long window, changed in place.
    """
    for kind in KINDS:
        own = far.gains[better(far.gains, THRUST if kind == MASS else kind)]
        other = beyond(far.gains, kind)
        if other > SURE and other > own + CLEAR:
            m.later[kind] = 1.0
    for kind in NEVER_LATER:
        if m.later[kind] > 0.0:
            far.gains[kind] = far.sizes[kind] = 0.0


@compiled
def restart(m, window):
    """Forget the whole flight's score, and begin it anew."""
    m.begun, m.sums, m.squares, m.noise, m.later[:] = 0, 0, 0.0, 0.0, 0.0
    forget(m)
    clear(window)


@compiled
def certain_always(far, m, least, kind):
    """Sigmas of a cause by the whole flight; 0 if the long window has seen one that began later.

    Args:
        far: VERDICT of the long window.
        m: MEMORY.
        least: smallest size of each kind that is a fault.
        kind: see hypotheses.py.
    """
    other = beyond(far.gains, kind)
    since = m.later[kind] == 0.0 and (other < WORTH or far.gains[kind] >= other)
    enough = kind != TURNED or m.sums >= LEAST_SUMS
    return certain(m.gains, m.sizes, least, kind) if since and enough else 0.0


@compiled
def surest(far, m, least, kind):
    """Sigmas of a cause by the long window, or by the whole flight."""
    return max(
        certain(far.gains, far.sizes, least, better(far.gains, kind)),
        certain_always(far, m, least, better(m.gains, kind)),
    )


@compiled
def confirms(innovations, found, kind):
    """Whether the innovations find the same size of a cause, within their own certainty.

    A controller answers the noise of the estimated velocity, and the estimate then comes back by
    itself: in every second of a quiet hold the push seems to do more than the file says. The
    windows hear that estimate. The innovations do not depend on what was done before.

    Args:
        innovations: innovations.MEMORY.
        found: VERDICT of a window.
        kind: see hypotheses.py.
    """
    gain, size = innovations.gains[kind], innovations.sizes[kind]
    if gain < WORTH or size * found.sizes[kind] < 0.0:
        return False
    sigma = abs(size) / np.sqrt(2.0 * gain)
    return abs(found.sizes[kind] - size) < max(3.0 * sigma, ROUGHLY * abs(found.sizes[kind]))


@compiled
def wrong_scale(suspected, m, least):
    """Sigmas of a wrong thrust or mass that the innovations confirm, as of `surest`.

    Args:
        suspected: jet_faults.MEMORY.
        m: MEMORY.
        least: smallest size of each kind that is a fault.
    """
    far, sure = suspected.far, 0.0
    recent, always = better(far.gains, THRUST), better(m.gains, THRUST)
    if confirms(suspected.innovations, far, recent):
        sure = certain(far.gains, far.sizes, least, recent)
    if confirms(suspected.innovations, m, always):
        sure = max(sure, certain_always(far, m, least, always))
    return sure


@compiled
def heading_off(suspected, m, least):
    """Sigmas of a heading that is off, as of `surest`.

    The windows do not know that jets may point elsewhere by a degree or two; the innovations do.
    So the whole flight's score counts only if the innovations find a heading of the same sign.
    Without them the long window decides.

    Args:
        suspected: jet_faults.MEMORY.
        m: MEMORY.
        least: smallest size of each kind that is a fault.
    """
    far, found = suspected.far, suspected.innovations
    if found.gains[TURNED] < WORTH or found.sizes[TURNED] * m.sizes[TURNED] < 0.0:
        return certain(far.gains, far.sizes, least, TURNED)
    return surest(far, m, least, TURNED)


@compiled
def lateness(near, m, least):
    """Sigmas of late poses by the short window, or by the whole flight.

    The windows hear the estimate, see `confirms`; so the innovations must find a delay, too.

    Args:
        near: jet_faults.MEMORY.
        m: MEMORY.
        least: smallest size of each kind that is a fault.
    """
    recent = certain(near.gains, near.sizes, least, LATE)
    if near.innovations.gains[LATE] < WORTH:
        return recent
    return max(recent, certain_always(near.far, m, least, LATE))


def verdict_of(suspected: Any, m: Any, kind: int) -> Any:
    """The window that names a cause of this kind: the short, the long one, or the whole flight.

    Args:
        suspected: jet_faults.MEMORY.
        m: MEMORY.
        kind: see hypotheses.py.
    """
    found = suspected.far
    if kind in SHORT or (kind == WEAK and suspected.weak_by == NEAR):
        found = suspected
    if kind == NUDGE and suspected.gains[kind] > found.gains[kind]:
        found = suspected
    return m if kind in KINDS and m.gains[kind] > found.gains[kind] else found
