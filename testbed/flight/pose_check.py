"""What is wrong with a pose: off the line of the poses before, frozen, or seen elsewhere.

Three consecutive poses of a body lie on a line, apart from camera noise. A body that is seen
elsewhere from one pose to the next, at the same velocity, was not pushed: the cameras' frame or the
body's markers moved, or its poses are late.
"""

import numpy as np

from testbed.core.compiled import compiled
from testbed.core.se2 import wrap_compiled

BEND = 0.5  # allowed acceleration: five times that of the jets [m/s^2]
BEND_SPIN = 2.0  # [rad/s^2]
STEP = 6.0  # smallest such step [sigmas]
STILL = 0.5  # poses nearer than this to the one before are as if frozen [sigmas of the noise]
SLOW = 0.003  # below this a vehicle counts as not moving [m/s]
SLOW_SPIN = 0.02  # below this it counts as not turning [rad/s]
STILLS = 5  # so many in a row are not accepted while the vehicle moves; by chance one in 10^8


@compiled
def off_line(last, sample, noise):
    """Squared distance of a pose from the line through the two before, in noise variances; mean 1.

    Args:
        last: the two, rows (t, x, y, theta), newest last; shifted in place.
        sample: this one, shape (4,).
        noise: variances of a pose, of position and heading.
    """
    span = last[1, 0] - last[0, 0]
    step = sample[0] - last[1, 0]
    known = span > 0.0
    ahead = step / span if known else 0.0
    dx = sample[1] - last[1, 1] - ahead * (last[1, 1] - last[0, 1])
    dy = sample[2] - last[1, 2] - ahead * (last[1, 2] - last[0, 2])
    before = wrap_compiled(last[1, 3] - last[0, 3])
    turn = wrap_compiled(sample[3] - last[1, 3] - ahead * before)
    for i in range(4):
        last[0, i], last[1, i] = last[1, i], sample[i]
    if not known:
        return 1.0
    width = 1.0 + (1.0 + ahead) * (1.0 + ahead) + ahead * ahead  # of three poses' noise
    bend = 0.5 * step * (span + step)
    bend *= bend
    moved = 0.5 * (dx * dx + dy * dy) / (width * noise[0] + BEND * BEND * bend)
    return max(moved, turn * turn / (width * noise[1] + BEND_SPIN * BEND_SPIN * bend))


@compiled
def is_still(m, sample, noise):
    """Whether a moving body's pose equals the one before, or is the last of several that nearly do.

    At rest, cameras that are better than their file say nearly the same again and again.
    """
    last, exact, near = m.last[1], True, True
    share = STILL * STILL * min(1.0, m.usual)
    for i in range(1, 4):
        d = sample[i] - last[i]
        exact, near = exact and d == 0.0, near and d * d <= share * noise[i // 3]
    moves = np.hypot(m.x[3], m.x[4]) > SLOW or abs(m.x[5]) > SLOW_SPIN
    m.still = m.still + 1 if near and moves else 0
    return moves and (exact or m.still >= STILLS)


@compiled
def note_step(m, dx, dy, turn, spread, spread_spin):
    """Note in `m.step` where the body is seen without having been pushed; false: it was pushed.

    A push shows as a distance that grows; a step is there from one pose to the next.

    Args:
        m: MEMORY.
        dx: from the prediction to the pose that is accepted now [m].
        dy: [m].
        turn: [rad].
        spread: variance of that distance.
        spread_spin: and of that angle.
    """
    ahead = m.t - m.apart[0]
    grows = (m.apart[0] - m.since) / ahead if ahead > 0.0 else 0.0
    ex, ey, et = m.apart[1], m.apart[2], m.apart[3]
    by = grows * np.hypot(dx - ex, dy - ey)
    ex, ey = ex - m.prior[0], ey - m.prior[1]
    if np.hypot(ex, ey) > 2.0 * by + STEP * np.sqrt(spread):
        m.step[0], m.step[1] = ex, ey
    by, et = grows * abs(turn - et), et - m.prior[2]
    if abs(et) > 2.0 * by + STEP * np.sqrt(spread_spin):
        m.step[2] = et
    m.going[:] = m.x[3:6]
    return seen_elsewhere(m.step)


@compiled
def seen_elsewhere(step):
    """Whether a `step` as of `note_step` is one."""
    return step[0] != 0.0 or step[1] != 0.0 or step[2] != 0.0
