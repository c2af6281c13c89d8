"""A push at once, by a hand for instance, as a cause of unexplained motion.

Its column is a jump of velocity at one look and nothing after it, as the estimate shows one. The
look is not known, so every recent one is tested; a persistent cause explains a nudge worse, as its
push goes on, and a nudge explains a persistent cause worse, as it does not. See the first lines of
`jet_faults` for the arithmetic.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.compiled import compiled
from testbed.core.scratch import scratch
from testbed.flight.hypotheses import NUDGE, gained
from testbed.flight.window import suspect

Array = NDArray[np.float64]

AGO = 30  # looks whose beginnings the short window tests
LONG_AGO = 120  # beginnings that the long window tests, one in EACH looks
EACH = 2
MOST = 1.0  # [m/s]
MOST_SPIN = 3.0  # [rad/s]
UNKNOWN = 5.0  # gain that any of so many instants, on three axes, gives by chance: ln(120)


class Nudges(NamedTuple):
    """Columns x'z, x'x, x'e of a push along x, along y and of a turn, changed in place."""

    near: Array  # by beginning, (m + 2, 3 AGO)
    far: Array  # (m + 2, 3 LONG_AGO)


@compiled
def add(columns, place, parts, weight, x):
    """Add what a nudge with place `place` of `columns` gives in this residual.

    Args:
        columns: of Nudges.
        place: of the nudge.
        parts: share of the nudge in this residual, push and turn.
        weight: 1 / variance, push and turn.
        x: uncertain parameters first, and the residual as the last column, (3, > m).
    """
    m, count = columns.shape[0] - 2, columns.shape[1] // 3
    for axis in range(3):
        h, part, sure = axis * count + place, parts[axis // 2], weight[axis // 2]
        for k in range(m):
            columns[k, h] += part * sure * x[axis, k]
        columns[m, h] += part * part * sure
        columns[m + 1, h] += part * sure * x[axis, -1]


@compiled
def judge(columns, least, y, found):
    """Write the nudge that explains most to `found`, a record of VERDICT."""
    count = columns.shape[1] // 3
    parts, fits, own = scratch((4, 3 * count)), scratch(3 * count), scratch(3 * count)
    suspect(columns, least, y, parts, fits, own)
    for h in range(count):
        x, gain_x = gained(fits[h], own[h], -MOST, MOST)
        y_, gain_y = gained(fits[count + h], own[count + h], -MOST, MOST)
        turn = gained(fits[2 * count + h], own[2 * count + h], -MOST_SPIN, MOST_SPIN)
        gain = gain_x + gain_y + turn[1] - UNKNOWN
        if gain > found.gains[NUDGE]:
            found.gains[NUDGE], found.sizes[NUDGE] = gain, np.sqrt(x * x + y_ * y_)


@compiled
def note(near, shown, look, weight, remembers, x):
    """Add a look to the nudges of the short window, see `Nudges`."""
    count = near.shape[1] // 3
    near *= remembers
    for axis in range(3):
        near[:, axis * count + look % count] = 0.0
    for q in range(min(shown.shape[0], count)):
        if look >= q:
            add(near, (look - q) % count, (shown[q, 0], shown[q, 1]), weight, x)


@compiled
def note_long(far, shown, look, looks, weight, remembers, x):
    """Add the sum of the last `looks` looks to the nudges of the long window."""
    count = far.shape[1] // 3
    far *= remembers
    for ago in range(looks + shown.shape[0] - 1):
        begun = look - ago
        if begun < 0 or begun % EACH != 0:
            continue
        place = begun // EACH % count
        if ago < looks:
            for axis in range(3):
                far[:, axis * count + place] = 0.0
        push = turn = 0.0
        for q in range(max(0, ago - looks + 1), min(ago + 1, shown.shape[0])):
            push += shown[q, 0]
            turn += shown[q, 1]
        add(far, place, (push, turn), weight, x)
