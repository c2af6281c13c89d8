"""Causes that have been there since the flight began, scored over the whole flight.

A file that is wrong, or cameras whose body is turned, push in every second that the jets fire. The
long window of `jet_faults` takes a part of such a push for noise, because its noise is the change
from one second to the next, and it forgets the start, where a vehicle pushes hardest. Here all
seconds have the same weight, none is forgotten, and the noise is what the best cause leaves of
the residuals. See the first lines of `jet_faults` for the arithmetic.
"""

from typing import Any

from testbed.core.compiled import borrowed, compiled, keep
from testbed.flight.hypotheses import (
    CLEAR,
    LATE,
    MASS,
    NUDGE,
    SHORT,
    THRUST,
    TURNED,
    WEAK,
    better,
    beyond,
    certain,
)
from testbed.flight.jet_faults import SPIN_SPREAD, SPREAD, is_weak
from testbed.flight.record import record
from testbed.flight.window import VERDICT, Window, clear, decide, factor, forget, listen

KINDS = (THRUST, MASS, TURNED, LATE)  # that it names
APPARENT = 2.0  # an error of mass makes a delay of 0.1 s appear: less than this times the least
TURNS = (SPIN_SPREAD / SPREAD) ** 2  # variance of a turn, in variances of a push
MUCH = 72.0  # gain, 12 sigma: random healthy vehicles show a wrong delay or mass of up to 8
BELIEVED = 9.0  # weight of the spread at the start [residuals]

MEMORY = record(
    sums=int,  # so far
    squares=float,  # sum of the squared residuals, in those of a push [m^2/s^2]
    noise=float,  # variance of a push; 0: none was heard [m^2/s^2]
    **VERDICT,
)


@compiled
def hear(p, m, window, heard, far):
    """Add the looks that the long window has summed, all but its last.

    Args:
        p: jet_faults.Known.
        m: MEMORY, changed in place.
        window: Window of one block, changed in place.
        heard: jet_faults.Heard.
        far: VERDICT of the long window.
    """
    if m.sums == 0:
        m.noise = SPREAD * SPREAD
    window.spread[0], window.spread[1] = 1.0, TURNS
    e = heard.sums[-1]
    listen(window, e, heard.sums[:-1], 0.0, 1.0, 0.0)
    m.sums += 1
    m.squares += e[0] * e[0] + e[1] * e[1] + e[2] * e[2] / TURNS
    sure = 1.0 / (m.noise + (p.long - 1) * p.rough)
    weighed = Window(window.told * sure, window.blocks * sure, window.spread, window.last)
    root = factor(weighed.told, p.sure, 1.0 / (p.bumps * p.bumps + p.slope * p.slope))
    least, y = borrowed(root)
    forget(m)
    decide(weighed, least, y, p.period, True, m)
    m.gains[NUDGE], m.sizes[NUDGE] = far.gains[NUDGE], far.sizes[NUDGE]
    best = max(m.gains[:NUDGE].max(), 0.0)
    left = max(0.0, sure * m.squares - (y * y).sum() - 2.0 * best) / sure
    m.noise = (BELIEVED * SPREAD * SPREAD + left) / (BELIEVED + 3.0 * m.sums)
    keep((weighed, root))


@compiled
def restart(m, window):
    """Begin anew."""
    m.sums, m.squares, m.noise = 0, 0.0, 0.0
    forget(m)
    clear(window)


@compiled
def admitted(far, kind):
    """Whether the long window does not prefer another cause: one that began later."""
    return far.gains[kind] + CLEAR > beyond(far.gains, kind)


@compiled
def surest(far, m, least, kind):
    """Sigmas of a cause by the long window, or by the whole flight."""
    one = better(m.gains, kind)
    counts = admitted(far, one) and (one == TURNED or m.gains[one] > MUCH)
    always = certain(m.gains, m.sizes, least, one) if counts else 0.0
    return max(certain(far.gains, far.sizes, least, better(far.gains, kind)), always)


@compiled
def lateness(near, m, least):
    """Sigmas of late poses by the short window, or by the whole flight; `near` has the long one."""
    surely = m.sizes[LATE] > APPARENT * least[LATE] and m.gains[LATE] > MUCH
    counts = surely and admitted(near.far, LATE)
    always = certain(m.gains, m.sizes, least, LATE) if counts else 0.0
    return max(certain(near.gains, near.sizes, least, LATE), always)


def verdict_of(suspected: Any, m: Any, kind: int) -> Any:
    """The window that names a cause of this kind: the short, the long one, or the whole flight.

    Args:
        suspected: jet_faults.MEMORY.
        m: MEMORY.
        kind: see hypotheses.py.
    """
    found = suspected.far
    if kind in SHORT or (kind == WEAK and is_weak(suspected)):
        found = suspected
    if kind == NUDGE and suspected.gains[kind] > found.gains[kind]:
        found = suspected
    return m if kind in KINDS and m.gains[kind] > found.gains[kind] else found
