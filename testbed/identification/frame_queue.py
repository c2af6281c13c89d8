"""Times of poses that were read from a queue of camera frames.

A camera makes a frame each `frame` seconds; the reader is slower and takes the oldest one, so the
poses grow older until the queue is full and is emptied. The path shows it: poses one frame apart,
then a jump over the frames that were thrown away. At rest the jumps do not show, and the queue is
taken as emptied at its usual intervals.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
AROUND = 5  # rows on each side that tell the usual step
STILL = 2e-3  # [m] of a step: below, a jump tells little
UNEVEN = 0.15  # cost of an interval one row longer or shorter than usual
SPREAD = 0.3  # of the usual interval: most that one is longer or shorter


def frame_times(t: Array, path: Array, frame: float, most: int) -> Array:
    """Time of each pose but for a constant.

    Args:
        t: times of the rows, shape (n,) [s].
        path: positions, shape (n, 2) [m].
        frame: between two frames, less than between two rows [s].
        most: frames that are thrown away at once.
    """
    step = float(np.median(np.diff(t)))
    if not 1e-6 < step - frame < frame or len(t) < 2 * AROUND:
        return t
    found = jumps(path, most, most * frame / (step - frame))
    if not found:
        return t
    made = np.empty(len(t))
    first = found[0] + 1
    made[:first] = t[first] - (most + 1) * frame + frame * np.arange(1 - first, 1)
    for a, b in zip(found, [*found[1:], len(t) - 1], strict=True):
        made[a + 1 : b + 1] = t[a + 1] + frame * np.arange(b - a)
    return made


def jumps(path: Array, most: int, usual: float) -> list[int]:
    """Rows after which the queue was emptied: those that explain the jumps best, evenly spaced.

    Args:
        path: see `frame_times`.
        most: frames that are thrown away at once.
        usual: rows between two jumps.
    """
    step = np.diff(path, axis=0)
    typical = np.array([
        np.median(step[max(0, k - AROUND) : k + AROUND + 1], axis=0) for k in range(len(step))
    ])  # fmt: skip
    square = np.sum(typical**2, axis=1)
    excess = np.sum((step - typical) * typical, axis=1) / (square + STILL**2)  # in steps
    gain = np.clip(excess, -1.0, 1.5 * most) * np.minimum(1.0, np.sqrt(square) / STILL)
    low, high = int((1.0 - SPREAD) * usual), int((1.0 + SPREAD) * usual) + 1
    best, before = np.full(len(gain), -np.inf), np.full(len(gain), -1)
    for k in range(len(gain)):
        if k <= high:
            best[k] = gain[k]
        for gap in range(low, min(high, k) + 1):
            score = best[k - gap] + gain[k] - UNEVEN * (gap - usual) ** 2
            if score > best[k]:
                best[k], before[k] = score, k - gap
    late = best[-high:]
    k = len(gain) - len(late) + int(np.argmax(late))
    found = []
    while k >= 0:
        found.append(k)
        k = int(before[k])
    return found[::-1]
