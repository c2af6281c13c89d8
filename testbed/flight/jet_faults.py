r"""Detects faulty jets by comparing the motion with the commands.

A look is an interval of at least LOOK between two estimates. Its residual e is the change of the
estimated velocity and turn rate minus the change by plan and slope. Three kinds of causes explain
it:

    z_i   uncertain parameters: the thrust of every jet, the centre of mass, a steady torque, the
          local slope. Each is zero within its tolerance.
    x_j   jet j leaks or is stuck open: it pushes while it is not commanded
    x_j   jet j is too weak or stuck shut: it pushes less while it is commanded

A suspicion is one x_j of any size b that began some time ago and has held since. With the noise of
e as the unit and L L' = z'z + 1 / tolerances^2, the gain in log-likelihood of e is

    S_j = x_j'e - (L^-1 z'x_j)'(L^-1 z'e),   N_j = x_j'x_j - |L^-1 z'x_j|^2
    b = S_j / N_j within its bounds,         gain = b S_j - b^2 N_j / 2

and sqrt(2 gain) is the distance of jet j from a healthy one in standard deviations. A leaking jet
makes the vehicle fire the opposite one, and on average it looks as if that one gave no thrust. The
suspicion with the larger gain decides: a leak pushes all the time, also before the other jet is
commanded; a weak jet shows only while it is commanded.

The estimate shows a push with a delay, so z and x are delayed in the same way (see response.py).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.compiled import compiled, pasted
from testbed.core.jets import effect_matrix
from testbed.core.scratch import scratch
from testbed.core.se2 import to_table_compiled, velocity_at
from testbed.core.table import Table, Tilt
from testbed.core.vehicle import Vehicle
from testbed.flight import innovation_sums, innovations
from testbed.flight.effectiveness import resolve
from testbed.flight.estimator import EstimatorParams
from testbed.flight.hypotheses import PULL, causes, certain, least_of, pads_of, twist_of
from testbed.flight.nudges import Nudges, judge, note, note_long
from testbed.flight.record import record
from testbed.flight.response import response
from testbed.flight.window import (
    SHARED,
    VERDICT,
    WHITE,
    Window,
    age,
    decide,
    factor,
    forget,
    listen,
)

Array = NDArray[np.float64]

LOOK = 0.1  # least length of a look; faster ticks are combined: their residuals are dependent [s]
TRUSTED_AGE = 0.1  # the age of a pose that counts is at least this: fast cameras may lose some [s]
MEMORY_S = 10.0  # time constant of forgetting [s]
STRETCH = 1.0  # looks of the long window are summed over this [s]
LONG_MEMORY_S = 40.0  # [s]
LONG_BELIEVED = 3.0  # weight of the spread at the start [sums]
SETTLING = 20.0  # time constant of the mean of unexplained acceleration, the slope [s]
BLOCK = 0.3  # a suspicion begins at the start of a block of this length [s]
SHOWN = 10  # looks from one effectiveness to the next
CALM = 30  # looks; a fault is named within them
AGAIN = 200  # looks that the mean of unexplained acceleration has had before a restart
THRUST = 0.05  # smallest assumed thrust error of a jet, relative, one sigma
FILED = 0.02  # the same by the innovations, which believe the file's tolerance
BENT = math.radians(1.0)  # of its direction
INERTIA = 0.05  # of the moment of inertia, relative
BALANCE = 0.01  # smallest assumed error of the centre of mass, one sigma [m]
SLOPE = 2e-3  # assumed slope of an unknown table [m/s^2]
BUMPS = 5e-4  # assumed variation of the slope over the table [m/s^2]
ALIKE = 50.0  # looks for which a moving vehicle meets the same bump of a rougher table [assumed]
SPREAD = 1.5e-3  # of a velocity residual at the start, one sigma [m/s]
SPIN_SPREAD = 5e-3  # [rad/s]
BELIEVED = 30.0  # weight of the spread at the start [looks]
HARDEST = 3.0  # jets: a stronger push in a look is external


class Known(NamedTuple):
    """Constants of the vehicle for compiled code."""

    effect: Array  # acceleration by each fully open jet in B, (3, n) [m/s^2, rad/s^2]
    com: tuple[float, float]  # centre of mass in B [m]
    gyration: float  # mass over inertia [1/m^2]
    droop: float  # see vehicle.Air
    drag: float  # see fired.Model [1/s]
    spin_drag: float  # [1/s]
    sure: Array  # 1 / tolerance^2 of z, (m,)
    slope: float  # [m/s^2], one sigma
    bumps: float  # [m/s^2], one sigma
    rough: float  # variance of a look's push by bumps beyond BUMPS; they do not turn it [m^2/s^2]
    shown: Array  # see response.py, (looks, 2)
    twist: float  # see hypotheses.twist_of [rad/s^2]
    most: Array  # largest residual, push and turn [m/s, rad/s]
    period: float  # of a look [s]
    ticks: int  # in a look
    trusted_age: float  # largest age of a pose for evidence [s]
    block: int  # looks in a block
    keep: float  # factor of forgetting, per look
    long: int  # looks that are summed for the long window
    least: Array  # smallest size of each kind of cause that is a fault, see hypotheses.py
    pads: Array  # see hypotheses.pads_of, (2,)
    innovations: innovations.Known


MEMORY = record(
    seen=int,  # 1: `before` is known
    before=(4,),  # theta, velocity of the centre of mass, omega at the last look
    noted=int,  # ticks since then
    look=int,  # number of the last one
    counted=int,  # looks that count: with poses that were trusted
    again=int,  # AGAIN after a restart
    wait=int,  # looks until the estimator has settled
    summed=int,  # looks in `Heard.sums`
    stretches=int,  # sums so far
    began=int,  # block of the long window in which its best cause began
    pulled=float,  # size of the pull of which the long window is sure [m/s^2]; 0: none
    flies_open=int,  # 1: a jet that is stuck open is compensated
    probed=int,  # the jet that is compensated on a doubt, from 1; 0: none
    tested=int,  # 1: for long enough, and a leak of another one explains more
    far=record(**VERDICT),  # of the long window
    innovations=innovations.MEMORY,
    leak_by=int,  # window that is sure of a leak, see bad_jet.py
    weak_by=int,  # and of a weak jet
    **VERDICT,  # of the short one
)


class Evidence(NamedTuple):
    """Memory of the detector, changed in place."""

    duty: Array  # sum over the ticks since the last look, (2, n)
    recent: Array  # z and causes of the last looks, not yet delayed, (looks, 3, m + n + COLUMNS)
    bias: Array  # slow mean of unexplained acceleration [m/s^2, rad/s^2], (3,)
    sums: Array  # of causes and residuals as of `residual`, (3, m + n + COLUMNS + 1)
    calm: Array  # `bias` up to two spans of CALM ago, the older one first, (2, 3)
    off: Array  # deviation of each jet from what the innovations believe, as a share of it, (n,)
    sigma: Array  # of that, (n,)
    near: Window  # of looks
    far: Window  # of their sums
    innovations: innovation_sums.Sums
    nudges: Nudges


@pasted
def look(p, m, evidence, state, duty, thrust_scale):
    """Add a tick: the estimate, and the share of the tick for which each jet flowed.

    Args:
        p: Known.
        m: MEMORY, changed in place.
        evidence: Evidence.
        state: record.STATE.
        duty: see flow.flow_shares, shape (2, n).
        thrust_scale: of the thrust at the supply pressure.
    """
    evidence.duty[:] += duty
    m.noted += 1
    if m.seen == 1 and m.noted < p.ticks:
        return
    rx, ry = to_table_compiled(state.theta, p.com[0], p.com[1])
    vx, vy = velocity_at(state.vx, state.vy, state.omega, rx, ry)
    now = np.array((state.theta, vx, vy, state.omega))
    if m.seen == 1:
        m.look += 1
        m.wait = max(0, m.wait - 1)
        if m.wait == 0:
            m.counted += 1
        weigh(p, m, evidence, now, evidence.duty / p.ticks, thrust_scale)
    m.seen, m.noted = 1, 0
    m.before[:] = now
    evidence.duty[:] = 0.0


@compiled
def pause(p, m, evidence):
    """Ignore looks with untrusted poses, until the estimator has settled."""
    innovations.pause(m.innovations)
    pause_windows(p, m, evidence)


@compiled
def pause_windows(p, m, evidence):
    """`pause` the windows only: the innovations do not depend on the estimator."""
    m.seen, m.wait = 0, p.shown.shape[0]
    forget(m)
    forget(m.far)
    m.summed = 0
    evidence.recent[:] = evidence.sums[:] = 0.0


@compiled
def residual(before, now, duty, thrust_scale, known, evidence, look, late):
    """Write the causes of the motion since the last look, and what is unexplained of it, to `late`.

    That is its last column; it has the shape (3, m + n + COLUMNS + 1).
    """
    opened, given, n = duty[0], duty[1], duty.shape[1]
    period, shown = known.period, known.shown
    looks, m = shown.shape[0], n + SHARED
    theta = before[0] + 0.5 * period * before[3]
    c, s = np.cos(theta), np.sin(theta)
    open_jets = 0.0
    for j in range(n):
        open_jets += max(0.0, opened[j])
    level = period * thrust_scale
    beside = 1.0 / (1.0 + known.droop * max(0.0, open_jets - 1.0))  # the share of a leak
    fresh = evidence.recent[look % looks]
    fresh[:] = 0.0
    e, push = scratch(3), scratch(3)
    push[:] = 0.0
    slowed, unspun = 0.5 * period * known.drag, 0.5 * period * known.spin_drag
    e[0] = now[1] - before[1] - period * evidence.bias[0] + slowed * (before[1] + now[1])
    e[1] = now[2] - before[2] - period * evidence.bias[1] + slowed * (before[2] + now[2])
    e[2] = now[3] - before[3] - period * evidence.bias[2] + unspun * (before[3] + now[3])
    push_x = push_y = 0.0
    for j in range(n):
        ax, ay = known.effect[0, j], known.effect[1, j]
        whole = (level * (c * ax - s * ay), level * (s * ax + c * ay), level * known.effect[2, j])
        idle = beside * (1.0 - min(max(opened[j], 0.0), 1.0))
        for axis in range(3):
            fresh[axis, j] = given[j] * whole[axis]
            fresh[axis, m + j] = idle * whole[axis]
            push[axis] += given[j] * whole[axis]
            e[axis] -= given[j] * whole[axis]
        push_x += given[j] * ax
        push_y += given[j] * ay
    fresh[2, n] = -level * push_y * known.gyration  # the centre of mass is further along x, y
    fresh[2, n + 1] = level * push_x * known.gyration
    fresh[2, n + 2] = fresh[0, n + 3] = fresh[1, n + 4] = period
    causes(fresh, m + n, push, before, now, period, known.pads, evidence.recent, look)
    rows = fresh.shape[1]
    late[:] = 0.0
    for axis in range(3):
        most = known.most[0] if axis < 2 else known.most[1]
        late[axis, rows] = min(max(e[axis], -most), most)
        for q in range(looks):
            then, part = evidence.recent[(look - q) % looks], shown[q, axis // 2]
            for i in range(rows):
                late[axis, i] += part * then[axis, i]


@compiled
def weigh(known, m, evidence, now, duty, thrust_scale):
    """Add one look, in place, and keep the best suspicion of each kind in `m`.

    Args:
        known: Known.
        m: MEMORY.
        evidence: Evidence.
        now: theta, velocity of the centre of mass, omega at this look, shape (4,).
        duty: share of the time since the last one for which each jet flowed, see flow.flow_shares,
            shape (2, n).
        thrust_scale: of the thrust at the supply pressure.
    """
    x = scratch((3, evidence.sums.shape[1]))
    residual(m.before, now, duty, thrust_scale, known, evidence, m.look, x)
    near, bias = evidence.near, evidence.bias
    if m.wait > 0:  # recent poses were not trusted: this look is only stored
        forget(m)
        return
    sums = evidence.sums
    for axis in range(3):
        for i in range(x.shape[1]):
            sums[axis, i] += x[axis, i]
    settling = max(1.0 / (m.counted + m.again), known.period / SETTLING)
    if m.look % CALM == 0:
        evidence.calm[0] = evidence.calm[1]
        evidence.calm[1] = bias
    for axis in range(3):  # the long window keeps what is steady, and explains it itself
        sums[axis, -1] += known.period * bias[axis]
    if m.look % known.block == 1 % known.block:  # after `weigh_short`: each block is whole there
        age(near, 0)
    trust = max(1.0 - known.keep, 1.0 / (m.counted + BELIEVED))
    listen(near, x, trust, known.keep, known.rough, WHITE)
    weight = 1.0 / (near.spread[0] + known.rough), 1.0 / near.spread[1]
    note(evidence.nudges.near, known.shown, m.look, weight, known.keep, x)
    for axis in range(3):
        bias[axis] += settling * x[axis, -1] / known.period
    if m.look % SHOWN == 0:
        resolve(evidence.innovations.slow, known.innovations.sure, evidence.off, evidence.sigma)
    if m.look % known.block == 0:
        weigh_short(known, m, evidence)
    m.summed += 1
    if m.summed == known.long:
        weigh_long(known, m, evidence)


@compiled
def weigh_short(known, m, evidence):
    """Keep what the window of looks says in `m`, at the end of each block."""
    forget(m)
    slope = known.bumps * known.bumps + known.slope * known.slope / (1.0 + 0.1 * m.counted)
    z = known.sure.shape[0]
    least, y = scratch((z, z)), scratch(z)
    factor(evidence.near.normal, known.sure, 1.0 / slope, least, y)
    decide(evidence.near, least, y, known.period, known.twist, False, m)
    judge(evidence.nudges.near, least, y, m)


@compiled
def note_pull(known, m, evidence):
    """Keep the pull of which the long window is sure. When it begins or ends, forget the jets."""
    sure = certain(m.far.gains, m.far.sizes, known.least, PULL)
    pulled = m.far.sizes[PULL] if sure > 0.0 else 0.0
    if (pulled > 0.0) != (m.pulled > 0.0):
        evidence.innovations.slow[:] = 0.0
    m.pulled = pulled


@compiled
def weigh_long(known, m, evidence):
    """Add the sum of the last looks to the long window, and keep what it says in `m.far`.

    Pushes add up over a second, while the noise of its residual is that of a look. The first sum
    is left out: the estimator finds its velocity in it, and that looks like a pull.
    """
    far, remembers = evidence.far, 1.0 - known.long * known.period / LONG_MEMORY_S
    forget(m.far)
    m.stretches += 1
    if m.stretches == 1:
        m.summed, evidence.sums[:] = 0, 0.0
        return
    age(far, m.began)
    trust = max(1.0 - remembers, 1.0 / (m.stretches + LONG_BELIEVED))
    rough = known.long * known.rough
    listen(far, evidence.sums, trust, remembers, rough, WHITE)
    weight = 1.0 / (far.spread[0] + rough), 1.0 / far.spread[1]
    pushes, sums = evidence.nudges.far, evidence.sums
    note_long(pushes, known.shown, m.look, known.long, weight, remembers, sums)
    slope = known.bumps * known.bumps + known.slope * known.slope
    z = known.sure.shape[0]
    least, y = scratch((z, z)), scratch(z)
    factor(far.normal, known.sure, 1.0 / slope, least, y)
    m.began = decide(far, least, y, known.period, known.twist, True, m.far)
    judge(evidence.nudges.far, least, y, m.far)
    m.summed, evidence.sums[:] = 0, 0.0


def slopes(tilt: Tilt) -> tuple[float, float]:
    """Slope of a table, and its variation over the table [m/s^2]."""
    nodes = np.array([node for row in tilt.map for node in row] or [(0.0, 0.0)])
    mean = nodes.mean(axis=0)
    bumps = float(np.hypot(*(nodes - mean).T).max())
    return max(SLOPE, float(np.hypot(*(mean + tilt.uniform)))), max(BUMPS, bumps)


def known_of(vehicle: Vehicle, period: float, estimator: EstimatorParams, table: Table) -> Known:
    """Constants of a vehicle; `period` is the jet period [s].

    A look is no shorter than a camera frame: without a pose the estimate shows no push in it.
    """
    mocap = table.mocap
    ticks = max(1, round(LOOK / period), math.ceil(mocap.frame_s / period - 1e-9))
    period *= ticks
    n = len(vehicle.jets)
    scale = np.array([[vehicle.mass], [vehicle.mass], [vehicle.inertia]])
    effect = effect_matrix(vehicle.jets, about=vehicle.com) / scale
    tolerance = np.full(n + SHARED, max(THRUST, vehicle.tolerance.thrust))
    tolerance[n:] = max(BALANCE, vehicle.tolerance.com)
    tolerance[n + 2] = innovations.SPIN * twist_of(vehicle)
    push = float(np.hypot(effect[0], effect[1]).max())
    turn = float(np.abs(effect[2]).max())
    slope, bumps = slopes(table.tilt)
    hardest = HARDEST * np.array([push, turn])
    bent = max(BENT, math.radians(vehicle.tolerance.direction_deg))
    thrust, inertia = vehicle.tolerance.thrust, vehicle.tolerance.inertia
    tolerances = max(FILED, thrust), bent, max(INERTIA, inertia), tolerance[n]
    believes = innovations.known_of(vehicle, mocap, bumps, tolerances, hardest)
    return Known(
        effect, vehicle.com, vehicle.mass / vehicle.inertia,
        vehicle.air.droop, vehicle.drag / vehicle.mass, vehicle.spin_drag / vehicle.inertia,
        tolerance**-2.0,
        slope, bumps, ALIKE * (period * (bumps - BUMPS)) ** 2,
        np.ascontiguousarray(response(estimator, vehicle, mocap, period)),
        twist_of(vehicle), period * hardest, period,
        ticks, max(TRUSTED_AGE, mocap.oldest_s), max(1, round(BLOCK / period)),
        1.0 - min(0.5, period / MEMORY_S), max(1, round(STRETCH / period)),
        least_of(vehicle, table, bumps), pads_of(vehicle), believes,
    )  # fmt: skip
