"""Which jet is bad, by what the windows of `jet_faults` say.

A jet is named only if it explains the motion better than every other cause.
"""

import numpy as np

from testbed.core.compiled import compiled
from testbed.flight.hypotheses import CLEAR, LEAK, NUDGE, SIMILAR, SURE, WEAK, beyond, outlasts

NOTHING, NEAR, INNOVATIONS, FAR = range(4)  # windows that may be sure of a jet
ENOUGH = 0.2  # smallest missing share of thrust that is a fault
TRACE = 0.05  # smallest leak that is a fault, as a share of thrust
FINE = 0.08  # the same by the innovations, without a probe
UNSURE = 0.2  # the same beside a jet that is stuck open, whose thrust is not known exactly
LONG_SURE = 18.0  # least gain of a weak jet in the long window: 6 sigma
UNLIKE = 0.6  # largest gain of a leak beside it, as a share
PART = 0.15  # smallest missing share of thrust that is worth a warning
DOUBT = 0.2  # of the smaller of two gains: thrust and slope are not known better
# A jet that was not used before its fault and lacks 30 % is 6 sigma of the tolerance (THRUST) from
# its file, however long it fires, and often less. So 4.3 sigma of the innovations are enough, if
# they last for more looks in which it fires than this.
LIKELY_LOOKS = 3
LEAK_LOOKS = 10  # of a leak that is not large
SURE_LOOKS = 1  # of 5 sigma: a single pulse that a board dropped lacks all of its thrust
CLEARER = 1.0  # as CLEAR, by the innovations: their gains are tens to hundreds


@compiled
def apart(gain, other):
    """Difference in gain that separates two causes."""
    return CLEAR + DOUBT * min(gain, other)


@compiled
def leaks(m, least):
    """Whether the suspected jet pushes without a command, and nothing else explains the motion.

    Args:
        m: a jet_faults.MEMORY.
        least: smallest size of each kind of cause, see hypotheses.least_of.
    """
    other = beyond(m.gains, LEAK)
    sure = m.leak.gain > other + apart(m.leak.gain, other) and m.leak.gain > SURE
    return sure and m.leak.share > max(trace(m), least[LEAK]) and outlasts(m.gains, LEAK)


@compiled
def leaks_by_innovations(m):
    """Whether the innovations name a leak, a small one later, and nothing else explains the motion.

    Two jets that push alike explain it alike; both are named then, see hypotheses.leaking. Beside a
    jet that was probed for long enough a leak needs no margin, and counts from TRACE on: the probe
    has told them apart.
    """
    found, leak = m.innovations, m.innovations.leak
    other = 0.0
    for kind in range(NUDGE):
        if kind != LEAK and (kind != WEAK or m.tested == 0):
            other = max(other, found.gains[kind])
    clear = leak.gain > SURE and leak.gain > other + CLEARER + SIMILAR * min(leak.gain, other)
    clear = clear and leak.gain > found.weak.gain + CLEARER
    large = leak.share > ENOUGH and found.leak_held > 1
    fine = FINE if m.tested == 0 else TRACE
    lasts = leak.share > max(fine, trace(m)) and found.leak_held > LEAK_LOOKS
    lasts = lasts and leak.gain > LONG_SURE
    return clear and (large or lasts) and leak.gain > nudge_of(m) + CLEAR


@compiled
def nudge_of(m):
    """Gain of a nudge, by the window that it suits best."""
    return max(m.gains[NUDGE], m.far.gains[NUDGE])


@compiled
def leak_of(m):
    """The suspicion of a leak: by the window that is sure of one."""
    return m.innovations.leak if m.leak_by == INNOVATIONS else m.leak


@compiled
def weak_of(m):
    """The suspicion of a weak jet: by the window that is sure of one, else by the long one."""
    if m.weak_by == INNOVATIONS:
        return m.innovations.weak
    return m.weak if m.weak_by == NEAR else m.far.weak


@compiled
def trace(m):
    """Smallest leak that is a fault, as a share of thrust."""
    return UNSURE if m.flies_open == 1 else TRACE


@compiled
def is_weak(m):
    """Whether the suspected jet is too weak, and nothing else explains the motion."""
    return m.weak.share > ENOUGH and weakness_is_clear(m)


@compiled
def decide_by(m, least):
    """Write to `m` which windows are sure of a bad jet; the arguments are those of `leaks`.

    The innovations see a leak of the opposite jet first. Beside it, no jet is weak.
    """
    m.leak_by = m.weak_by = NOTHING
    if leaks_by_innovations(m):
        m.leak_by = INNOVATIONS
        return
    if leaks(m, least):
        m.leak_by = NEAR
    if is_weak(m) and m.weak.gain > SURE:
        m.weak_by = NEAR
    elif is_weak_by_innovations(m):
        m.weak_by = INNOVATIONS
    elif m.far.weak.gain > LONG_SURE and is_weak(m.far) and is_no_leak(m.far):
        m.weak_by = FAR


@compiled
def is_weak_by_innovations(m):
    """Whether the innovations name a weak jet: it explains more than any other cause or jet.

    A leak of another jet may explain as much, see reconfiguration.is_a_guess.
    """
    weak, other = m.innovations.weak, m.innovations.weak.next
    for kind in range(NUDGE):
        if kind not in (WEAK, LEAK):
            other = max(other, m.innovations.gains[kind])
    leak = m.innovations.leak.gain
    clear = weak.gain > max(other + CLEARER, leak - CLEARER)
    fresh = weak.jet != m.probed - 1  # that one was named
    lasts = m.innovations.held > (SURE_LOOKS if weak.gain > SURE else LIKELY_LOOKS)
    large = weak.share > ENOUGH
    return fresh and lasts and large and clear and weak.gain > nudge_of(m) + CLEAR


@compiled
def is_no_leak(far):
    """Whether a leak of the opposite jet explains far less, by the long window.

    On average over a second the two look alike.
    """
    return far.leak.gain < UNLIKE * far.weak.gain


@compiled
def is_partly_weak(m):
    """Whether a jet lacks less than what is a fault, and nothing else explains the motion."""
    return PART < m.weak.share <= ENOUGH and is_no_leak(m) and weakness_is_clear(m)


@compiled
def weakness_is_clear(m):
    """Whether a weak jet explains the motion better than any other cause."""
    other = beyond(m.gains, WEAK)
    clear = m.weak.gain >= other + apart(m.weak.gain, other)
    return clear and outlasts(m.gains, WEAK)


@compiled
def leaks_or_is_weak(m, least):
    """Whether one jet may leak; if it does not, the next best cause is the right one.

    The arguments are those of `leaks`.

    No jet is in doubt while the long window is sure of a pull: once the short window has forgotten
    when the pull began, a leak explains it nearly as well.
    """
    if m.leak_by == INNOVATIONS:
        return False
    other = beyond(m.gains, LEAK)
    may = (
        m.pulled == 0.0
        and m.leak.gain > other - apart(m.leak.gain, other)
        and m.leak.share > max(trace(m), least[LEAK])
    )
    return may and outlasts(m.gains, LEAK)


@compiled
def weak_is_likely(m):
    """Whether a weak jet explains nearly as much as a leak, by the surer window."""
    leak, weak = m.innovations.leak.gain, m.innovations.weak.gain
    if innovations_are_surer(m):
        return weak > leak - CLEARER - SIMILAR * min(leak, weak)
    return m.weak.gain > m.leak.gain - apart(m.leak.gain, m.weak.gain)


@compiled
def innovations_are_surer(m):
    """Whether the innovations are surer of a leak than the short window."""
    return m.innovations.leak.gain > m.leak.gain


@compiled
def sigmas(suspicion):
    """Distance from a healthy vehicle in standard deviations."""
    return np.sqrt(2.0 * suspicion.gain)
