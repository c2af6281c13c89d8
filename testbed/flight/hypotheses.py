"""Causes of unexplained motion beside a single jet; scored on the same looks as the jets.

Each cause adds columns x to those of `jet_faults`. Its size and gain in log-likelihood follow as
for a jet, so that all causes can be compared: the one with the largest gain is named, and how
sure that is.

    PULL    a constant force in W: a hose, a cable, a tilt       x = (h, 0, 0) and (0, h, 0)
    DRAG    the pads drag                                        x = -h velocity
    THRUST  all jets give more or less than the file says        x = the jets' push and turn
    MASS    the same of the push only                            x = the jets' push
    TURNED  the cameras' heading is off                          x = the push turned by 90 degrees
    LATE    poses are older than their stamps                    x = an earlier push less this one
    TWIST   a constant torque: a hose, the bearings' air         x = (0, 0, h)
    NUDGE   a push at once, and none after it                    see nudges.py
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.codes import Detector
from testbed.core.compiled import compiled
from testbed.core.jets import effect_matrix
from testbed.core.landing import PADS
from testbed.core.table import Table
from testbed.core.vehicle import Vehicle

Array = NDArray[np.float64]

LEAK, WEAK, PULL, DRAG, THRUST, MASS, TURNED, LATE, TWIST, NUDGE = range(10)
KINDS = 10
DELAYS = 4  # tested delays: 1 to so many looks
# columns, after those of the jets
X, Y, SPUN, SLOWED, ALL, PUSHED, ROTATED, DELAYED = range(8)
COLUMNS = DELAYED + DELAYS
MOST_PULL = 1.0  # [m/s^2]
MOST_TWIST = 0.25  # of what the strongest jet turns; a stronger torque is no hose's
MOST_DRAG = 20.0  # [N s/m]
MOST_SCALE = 3.0  # thrust of four times the file's
MOST_TURN = 0.6  # [rad]
MOST_DELAY = 1.3  # of the tested one
# smallest sizes that are faults
LEAST_PULL = 2e-3  # [m/s^2]; a table that is not level changes by less from place to place
STEEPER = 4.0  # bumps of the table file: less than this is the table
HIDES = 0.25  # of these bumps: the short window cannot tell a leak that pushes less from the table
LEAST_DRAG = 0.4  # [N s/m]
PATCHY = 10.0  # on a table with patches of friction [N s/m]
LEAST_SCALE = 0.25  # of thrust or mass; the safety filter allows for 10 %
LEAST_TURN = math.radians(4.0)
LEAST_DELAY = 0.07  # [s]
LEAST_NUDGE = 5e-3  # [m/s]; less does not disturb a flight
WORTH = 8.0  # least gain of a cause that gets a number: 4 sigma
SURE = 12.5  # of one that brakes, or refutes others: 5 sigma
CLEAR = 3.0  # difference in gain that separates two causes (a factor e^3 in likelihood)
SIMILAR = 0.07  # of the smaller gain, beside that: no file knows how a jet pushes more exactly


@compiled
def causes(fresh, first, push, before, now, period, pads, evidence, look):
    """Write the columns of a look into the rows of `fresh` from `first` on.

    Args:
        fresh: possible causes of this look's residual, (3, rows).
        first: place of the first cause.
        push: what the jets add to the velocity in this look, (3,).
        before: theta, vx, vy, omega at the last look.
        now: the same at this one.
        period: of a look [s].
        pads: 1 / mass, and of turning [1/kg].
        evidence: causes of the last looks, see jet_faults.Evidence.recent.
        look: number of this one.
    """
    fresh[0, first + X] = fresh[1, first + Y] = fresh[2, first + SPUN] = period
    for axis in range(3):
        fresh[axis, first + SLOWED] = (
            -0.5 * period * pads[axis // 2] * (before[(axis + 1)] + now[(axis + 1)])
        )
        fresh[axis, first + ALL] = push[axis]
    fresh[0, first + PUSHED], fresh[1, first + PUSHED] = push[0], push[1]
    fresh[0, first + ROTATED], fresh[1, first + ROTATED] = -push[1], push[0]
    looks = evidence.shape[0]
    for d in range(DELAYS):
        then = evidence[(look - d - 1) % looks]
        for axis in range(3):
            fresh[axis, first + DELAYED + d] = then[axis, first + ALL] - push[axis]


@compiled
def gained(fits, own, low, high):
    """Size and gain of a cause; `fits` and `own` are S and N of jet_faults' first lines."""
    if own < 1e-9:
        return 0.0, 0.0
    size = min(max(fits / own, low), high)
    return size, size * fits - 0.5 * size * size * own


@compiled
def score(fits, own, first, period, twist, start, gains, sizes, way):
    """Keep the best of every kind in `gains` and `sizes`, and the direction of a pull in `way`.

    Thrust, mass and heading are tested from the oldest beginning only (`start`), because an error
    in a file is there before the flight.

    Args:
        fits: S of every column.
        own: N of every column.
        first: place of the first cause.
        period: of a look [s].
        twist: largest turn by a hose [rad/s^2].
        start: whether these sums go back to the oldest beginning.
        gains: changed in place.
        sizes: changed in place.
        way: changed in place.
    """
    px, gain_x = gained(fits[first + X], own[first + X], -MOST_PULL, MOST_PULL)
    py, gain_y = gained(fits[first + Y], own[first + Y], -MOST_PULL, MOST_PULL)
    if gain_x + gain_y > gains[PULL]:
        gains[PULL], sizes[PULL] = gain_x + gain_y, np.sqrt(px * px + py * py)
        way[0], way[1] = px, py
    one = first + SPUN
    keep(TWIST, 1.0, gained(fits[one], own[one], -twist, twist), gains, sizes)
    one = first + SLOWED
    keep(DRAG, 1.0, gained(fits[one], own[one], 0.0, MOST_DRAG), gains, sizes)
    if start:
        for kind, column in ((THRUST, ALL), (MASS, PUSHED)):
            one = first + column
            keep(kind, 1.0, gained(fits[one], own[one], -1.0, MOST_SCALE), gains, sizes)
        one = first + ROTATED
        keep(TURNED, 1.0, gained(fits[one], own[one], -MOST_TURN, MOST_TURN), gains, sizes)
    for d in range(DELAYS):
        one = first + DELAYED + d
        found = gained(fits[one], own[one], 0.0, MOST_DELAY)
        keep(LATE, (d + 1) * period, found, gains, sizes)


@compiled
def keep(kind, unit, found, gains, sizes):
    """Keep a size and its gain, if it is the best of its kind."""
    if found[1] > gains[kind]:
        gains[kind], sizes[kind] = found[1], unit * found[0]


@compiled
def beyond(gains, kind):
    """Gain of the best lasting cause of another kind; thrust and mass are one."""
    best = 0.0
    for other in range(KINDS):
        pair = min(kind, other) == THRUST and max(kind, other) == MASS
        if other not in (kind, NUDGE) and not pair:
            best = max(best, gains[other])
    return best


@compiled
def outlasts(gains, kind):
    """Whether a lasting cause explains more than a nudge.

    Both have the same thrust and slope, so no doubt about these counts here.
    """
    return gains[kind] > gains[NUDGE] + CLEAR


@compiled
def certain(gains, sizes, least, kind):
    """Sigmas of a cause that is large enough and explains more than any other; 0: it does not."""
    clear = gains[kind] > WORTH and gains[kind] > beyond(gains, kind) + CLEAR
    clear = clear and (kind == NUDGE or outlasts(gains, kind))
    return np.sqrt(2.0 * gains[kind]) if clear and abs(sizes[kind]) > least[kind] else 0.0


def least_of(vehicle: Vehicle, table: Table, bumps: float) -> Array:
    """Smallest size of each kind that is a fault."""
    least = np.zeros(KINDS)
    least[PULL] = max(LEAST_PULL, STEEPER * bumps)
    least[LEAK] = HIDES * bumps * vehicle.mass / min(jet.thrust for jet in vehicle.jets)
    least[DRAG] = PATCHY if table.friction else LEAST_DRAG
    scale = max(LEAST_SCALE, 3.0 * table.spread.thrust, 2.0 * vehicle.tolerance.thrust)
    least[THRUST] = least[MASS] = scale
    # how well the heading in motion capture and the directions of the nozzles are known
    aside = max(4.0 * table.spread.body_deg, 3.0 * vehicle.tolerance.direction_deg)
    least[TURNED] = max(LEAST_TURN, math.radians(aside))
    least[LATE] = max(LEAST_DELAY, 4.0 * table.spread.clock_s)
    least[NUDGE] = LEAST_NUDGE
    return least


def pads_of(vehicle: Vehicle) -> Array:
    """What a drag of 1 N s/m takes from velocity and spin [1/s]."""
    arm = PADS * vehicle.radius
    return np.array([1.0 / vehicle.mass, arm * arm / vehicle.inertia])


def twist_of(vehicle: Vehicle) -> float:
    """Largest turn by a hose [rad/s^2]."""
    turns = np.abs(effect_matrix(vehicle.jets, about=vehicle.com)[2]) / vehicle.inertia
    return MOST_TWIST * float(turns.max())


CAUSES = {  # detector -> kind of its cause
    Detector.JET_LEAKS: LEAK,
    Detector.JET_LEAKS_OR_WEAK: LEAK,
    Detector.JET_MISSING: WEAK,
    Detector.JET_PARTLY_WEAK: WEAK,
    Detector.PULL: PULL,
    Detector.PULL_SHARE: PULL,
    Detector.PAD_DRAG: DRAG,
    Detector.THRUST_OR_MASS: THRUST,
    Detector.HEADING_OFF: TURNED,
    Detector.POSES_LATE: LATE,
    Detector.NUDGED: NUDGE,
}


SHORT = (LEAK, LATE)  # kinds that the short window names


@compiled
def better(gains, kind):
    """The kind of cause to name: of thrust and mass the better one."""
    return MASS if kind == THRUST and gains[MASS] > gains[THRUST] else kind


def cause_of(m: Any, kind: int) -> int:
    """The kind of cause to name, see `better`; `m` is a record of window.VERDICT."""
    return better.py_func(m.gains, kind)  # type: ignore[attr-defined]


def words(m: Any, kind: int, mass: float) -> str:
    """A cause with its size, for a person; `m` is a record of window.VERDICT."""
    size = float(m.sizes[kind])
    match kind:
        case k if k == LEAK:
            much = (
                "all" if m.leak.share >= 1.0 else f"{m.leak.share:.0%}"
            )  # the estimate may exceed 1
            return f"{leaking(m.leak)} leaks {much} of its thrust"
        case k if k == WEAK:
            return f"jet {m.weak.jet + 1} gives {1.0 - m.weak.share:.0%} of its thrust"
        case k if k == PULL:
            way = math.degrees(math.atan2(m.way[1], m.way[0]))
            return f"hose or tilt pulls with {mass * size:.2f} N towards {way:.0f} deg"
        case k if k == DRAG:
            return f"pads drag with {size:.1f} N s/m"
        case k if k == TWIST:
            return f"a hose or the bearings' air turns it by {math.degrees(size):.1f} deg/s^2"
        case k if k == THRUST:
            return f"jets give {1.0 + size:.0%} of the file's thrust"
        case k if k == MASS:
            return f"mass is {1.0 / max(0.1, 1.0 + size):.0%} of the file's"
        case k if k == TURNED:
            # the jets push where the vehicle really points: turned back by the error
            return f"heading is off by {-math.degrees(size):.0f} deg"
        case k if k == NUDGE:
            return f"a nudge of {1e3 * size:.0f} mm/s"
    return f"poses are {size:.2f} s late"


def leaking(leak: Any) -> str:
    """The jet that leaks; two, if they push so much alike that either may be the one."""
    text = f"jet {leak.jet + 1}"
    if leak.next > leak.gain - CLEAR - SIMILAR * leak.next:
        text += f" or jet {leak.other + 1}"
    return text


def ranked(m: Any, kind: int, mass: float) -> str:
    """The cause that is named, how sure it is, and the next best one of another kind."""
    gains = m.gains.tolist()
    text = f"{words(m, kind, mass)} ({math.sqrt(2.0 * gains[kind]):.1f} sigma"
    rest = [other for other in range(KINDS) if other != kind and gains[other] > 0.5]
    if rest:
        other = max(rest, key=gains.__getitem__)
        also = "or" if gains[other] > gains[kind] - CLEAR else "next:"
        text += f"; {also} {words(m, other, mass)}, {math.sqrt(2.0 * gains[other]):.1f} sigma"
    return text + ")"
