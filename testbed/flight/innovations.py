"""A Kalman filter that believes the files, and the causes that its innovations speak for.

The estimator has to follow every disturbance, so its velocity is noisy, and what is left of a jet's
push in it is small. This filter has only the noise that the files state: of the cameras, of pulses,
of the slope from place to place. As long as the files are right, its velocity is known many times
better, and every push that is missing shows. Nothing flies by it.

For each cause of `hypotheses` it is known how the innovation would change with its size (A. S.
Willsky and H. L. Jones, "A generalized likelihood ratio approach to the detection and estimation of
jumps in linear systems", 1976): the same filter, without poses, driven by the push of the cause. So
the innovations are a regression on sizes, with white noise. The rest is as in `jet_faults`.

The sums of this regression, and what they say, are in `innovation_sums`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.compiled import compiled
from testbed.core.scratch import scratch
from testbed.core.se2 import to_table_compiled, wrap_compiled
from testbed.core.table import Mocap
from testbed.core.vehicle import Vehicle
from testbed.flight import effectiveness
from testbed.flight.hypotheses import (
    ALL,
    DELAYED,
    DELAYS,
    PUSHED,
    ROTATED,
    SLOWED,
    SPUN,
    X,
    Y,
    pads_of,
    twist_of,
)
from testbed.flight.innovation_sums import FORGETS, Look, add, age, clear, learn, weigh
from testbed.flight.record import record
from testbed.flight.window import VERDICT, forget

Array = NDArray[np.float64]

LOOK = 0.1  # innovations are of the mean pose of so long [s]
MEMORY_S = 300.0  # time constant of forgetting [s]
STAYS_S = 1000.0  # with which the uncertain parameters change [s, assumed]
GAP = 1.0  # after this time without poses the filter begins anew [s]
SLOPE = 0.02  # at the start, one sigma [m/s^2]
SPIN = 0.3  # at the start, one sigma, as a share of `Known.twist`
UNKNOWN = 0.2  # speed at the start, one sigma [m/s, rad/s]
WANDER = 1e-4  # unexplained acceleration, random walk [m/s^2 / sqrt(s)]
SPIN_WANDER = 1e-4  # [rad/s^2 / sqrt(s)]
CELL = 1.0  # the slope changes by the table's variation over this way [m, assumed]
FAR = 6.0  # sigmas: an innovation that changes by so much more than jets can push does not count


class Known(NamedTuple):
    """Constants of the vehicle for compiled code."""

    com: tuple[float, float]  # centre of mass in B, which the filter follows [m]
    noise: Array  # variance of its pose, of position and heading, (2,)
    pulse: float  # error of a pulse, relative, one sigma
    rolls: float  # variance of the slope's change over a way [m^2/s^4 / m]
    sure: Array  # 1 / tolerance^2 of z: thrust and direction of jets, inertia, mass centre, (m,)
    turned: Array  # torque of a jet's whole thrust that points 1 rad further, (n,) [N m]
    pads: Array  # see hypotheses.pads_of
    twist: float  # see hypotheses.twist_of [rad/s^2]
    hardest: Array  # largest acceleration that is the jets' [m/s^2, rad/s^2]
    period: float  # of a look [s]
    keep: float  # factor of forgetting, every FORGETS looks
    stays: float  # the same of the uncertain parameters


MEMORY = record(
    begun=int,  # 1: a pose has started the filter
    t=float,  # capture time of the newest pose [s]
    since=float,  # beginning of the look [s]
    heading=float,  # then [rad]
    poses=int,  # in this look
    at=(2,),  # sums over these poses: time since the beginning, and its square
    seen=(3,),  # sums of x and y, and of heading since the beginning
    looks=int,
    x=(3, 3),  # x, y, heading: position, velocity, unexplained acceleration
    cov=(3, 3, 3),  # of these
    before=(3,),  # innovation of the last look
    remembered=float,  # innovations, as far as they are not forgotten
    squares=float,  # what the uncertain parameters leave of them, in variances by the files
    began=int,  # beginning of the cause that explains most
    held=int,  # looks in which the same weak jet flowed and was likelier than LIKELY
    leak_held=int,  # looks in a row with the same leak, likelier than LIKELY
    noise=float,  # what the best cause leaves of these, each
    **VERDICT,
)


@compiled
def update(p, m, sums, flown, model, thrust_scale, sample):
    """Follow a pose that the estimator has accepted.

    Args:
        p: Known.
        m: MEMORY, changed in place.
        sums: Sums, changed in place.
        flown: see estimator.predict_mean; since the look began, set to 0 at its end.
        model: fired.Model.
        thrust_scale: of the thrust at the supply pressure.
        sample: captured at [s], x [m], y [m], theta [rad].
    """
    if m.begun == 0 or sample[0] - m.t > GAP:
        begin(p, m, sums, flown, sample)
        return
    m.t = sample[0]
    since = m.t - m.since
    m.poses += 1
    m.at[0], m.at[1] = m.at[0] + since, m.at[1] + since * since
    x, y = centre_of(p, sample)
    m.seen[0], m.seen[1] = m.seen[0] + x, m.seen[1] + y
    m.seen[2] += wrap_compiled(sample[3] - m.heading)
    sums.ways[:] += flown[1]
    if since > p.period - 1e-6:
        look(p, m, sums, flown, model, thrust_scale)


@compiled
def centre_of(p, sample):
    """Where the centre of mass is at a pose of the origin [m]."""
    x, y = to_table_compiled(sample[3], p.com[0], p.com[1])
    return sample[1] + x, sample[2] + y


@compiled
def begin(p, m, sums, flown, sample):
    """Start the filter at a pose; the sums stay, and the slope, if it is known."""
    m.begun, m.t = 1, sample[0]
    if sums.cov[0, 0] == 0.0:
        clear(p, sums)
    m.x[:, 0:2] = 0.0
    m.x[0, 0], m.x[1, 0] = centre_of(p, sample)
    m.x[2, 0] = sample[3]
    for axis in range(3):
        slope = m.cov[axis, 2, 2]
        if slope == 0.0:
            slope = (SPIN * p.twist) ** 2 if axis == 2 else SLOPE * SLOPE
        m.cov[axis] = 0.0
        m.cov[axis, 0, 0], m.cov[axis, 1, 1] = p.noise[axis // 2], UNKNOWN * UNKNOWN
        m.cov[axis, 2, 2] = slope
        m.before[axis] = 0.0
        sums.sure[axis, 0:2] = 0.0
        sums.moved[axis, 0:2] = sums.fades[axis, 0:2] = 0.0
    begin_look(m, sums, flown)


@compiled
def begin_look(m, sums, flown):
    """Begin a look at the newest pose."""
    m.since, m.heading, m.poses = m.t, m.x[2, 0], 0
    m.at[:] = m.seen[:] = 0.0
    sums.ways[:], flown[:] = 0.0, 0.0


@compiled
def pause(m):
    """Begin anew at the next pose: the last ones were not trusted."""
    m.begun = m.held = m.leak_held = 0
    forget(m)


@compiled
def restart(p, m, sums):
    """Forget all innovations."""
    pause(m)
    m.x[:], m.cov[:], m.remembered, m.squares, m.noise = 0.0, 0.0, 0.0, 0.0, 0.0
    clear(p, sums)


@compiled
def look(p, m, sums, flown, model, thrust_scale):
    """Hear the mean pose of a look, go to its end, and weigh the causes."""
    n, span = flown.shape[1], m.t - m.since
    one, two = m.at[0] / m.poses, 0.5 * m.at[1] / m.poses  # mean time, half its mean square
    z, count = sums.z.shape[0], sums.scores.shape[2]
    acts, gone = scratch((3, 3, z + count)), scratch((3, n))
    push, shaken = scratch((3, 3)), scratch(2)  # the latter: variance by pulses, see below
    errors, weights = scratch(3), scratch(3)
    seen = Look(
        scratch((3, 2)), scratch((3, 3)), scratch((3, 3)), scratch((3, z)), scratch((3, z)),
        scratch(3), scratch(3),
    )  # fmt: skip
    gone[0], gone[1] = flown[0], flown[1]
    for j in range(n):
        gone[2, j] = sums.ways[j] / m.poses
    whole = span, 0.5 * span * span, two
    for kind in range(3):
        for j in range(n):
            shut = whole[kind] - gone[kind, j]
            gone[kind, j] = sums.gives[j] * gone[kind, j] + sums.leaks[j] * shut
    effects(p, m, model, thrust_scale, gone, whole, acts, push)
    m.looks += 1
    age(p, m, sums)
    speed = np.hypot(m.x[0, 1], m.x[1, 1])
    for axis in range(3):
        state, cov, both = m.x[axis], m.cov[axis], acts[axis]
        shaken[:] = 0.0  # of velocity and of the mean pose
        for j in range(n):
            shaken[0] += (p.pulse * both[0, j]) ** 2
            shaken[1] += (p.pulse * both[2, j]) ** 2
        drag = model.spin_drag if axis == 2 else model.drag
        sees, steps = (one - drag * two, two), coasts(drag, span)
        both[0] -= drag * both[1]  # what drag takes of a push before the look is over
        push[0, axis] -= drag * push[1, axis]
        gain, variance = gain_of(cov, sees, p.noise[axis // 2] / m.poses + shaken[1])
        mean = m.seen[axis] / m.poses + (m.heading if axis == 2 else 0.0)
        error = mean - (state[0] + sees[0] * state[1] + sees[1] * state[2] + push[2, axis])
        most = p.hardest[axis // 2] * span * span + FAR * np.sqrt(variance)
        outside = min(abs(error), abs(error - m.before[axis])) > most
        m.before[axis] = error
        noise = variance
        if outside:
            noise, gain = np.inf, (0.0, 0.0, 0.0)
        for i in range(3):
            seen.steps[axis, i], seen.gain[axis, i] = steps[i], gain[i]
        seen.sees[axis, 0], seen.sees[axis, 1] = sees
        learn(sums, seen, axis, both, error, noise)
        errors[axis], weights[axis] = error, 1.0 / (noise * max(1.0, m.noise))
        m.remembered += 0.0 if outside else 1.0
        m.squares += seen.weight[axis] * seen.left[axis] * seen.left[axis]
        for i in range(3):
            state[i] += gain[i] * error
            for k in range(3):
                cov[i, k] -= variance * gain[i] * gain[k]
        stays, moves, drifts = steps
        state[0] += moves * state[1] + drifts * state[2] + push[1, axis]
        state[1] = stays * state[1] + moves * state[2] + push[0, axis]
        advance(cov, steps)
        walk = SPIN_WANDER * SPIN_WANDER if axis == 2 else WANDER * WANDER + p.rolls * speed
        cov[1, 1] += shaken[0]
        if outside:
            cov[0, 0] += error * error
            cov[1, 1] += UNKNOWN * UNKNOWN
        cov[2, 2] += span * walk
    effectiveness.learn(sums.slow, seen.g, errors, weights, p.period)
    add(sums, seen, acts)
    weigh(p, m, sums, gone[0])
    begin_look(m, sums, flown)


@compiled
def effects(p, m, model, thrust_scale, gone, whole, acts, push):
    """Write what a unit of each parameter and cause gives in a look, and what the jets give.

    Args:
        p: Known.
        m: MEMORY.
        model: fired.Model.
        thrust_scale: of the thrust at the supply pressure.
        gone: of each jet: impulse, its integral to the end of the look, and to its poses, (3, n).
        whole: the same of a constant unit push.
        acts: written, (3, 3, m + columns): for each axis velocity, way and mean pose.
        push: written, (3, 3): velocity, way and mean pose of each axis.
    """
    n, z = gone.shape[1], p.sure.shape[0]
    acts[:], push[:] = 0.0, 0.0
    other = z + 2 * n  # place of the first cause that is not a jet
    theta = m.x[2, 0] + 0.5 * whole[0] * m.x[2, 1]
    c, s = np.cos(theta), np.sin(theta)
    for kind in range(3):
        act, fx, fy = acts[:, kind], 0.0, 0.0
        for j in range(n):
            ax, ay = model.effect[0, j] / model.mass, model.effect[1, j] / model.mass
            flow = thrust_scale * gone[kind, j]
            rest = thrust_scale * whole[kind] - flow
            fx, fy = fx + flow * ax, fy + flow * ay
            turn = model.effect[2, j] / model.inertia
            along, across = c * ax - s * ay, s * ax + c * ay
            act[0, n + j], act[1, n + j] = -flow * across, flow * along
            act[2, n + j] = flow * p.turned[j] / model.inertia
            for axis, a in enumerate((along, across, turn)):
                act[axis, j] = act[axis, z + j] = flow * a
                act[axis, z + n + j] = rest * a  # its leak
                push[kind, axis] += flow * a
        act[2, 2 * n] = push[kind, 2] - whole[kind] * model.spin_drag * m.x[2, 1]
        act[2, 2 * n + 1] = -fy * model.mass / model.inertia  # its centre is further along x, y
        act[2, 2 * n + 2] = fx * model.mass / model.inertia
        act[0, other + X] = act[1, other + Y] = act[2, other + SPUN] = whole[kind]
        act[0, other + PUSHED], act[1, other + PUSHED] = push[kind, 0], push[kind, 1]
        act[0, other + ROTATED], act[1, other + ROTATED] = -push[kind, 1], push[kind, 0]
        for axis in range(3):
            speed = m.x[axis, 1]
            act[axis, other + ALL] = push[kind, axis]
            act[axis, other + SLOWED] = -whole[kind] * p.pads[axis // 2] * speed
            for d in range(DELAYS if kind == 2 else 0):  # the poses show where it was
                act[axis, other + DELAYED + d] = -(d + 1) * p.period * speed


@compiled
def coasts(drag, h):
    """Share of a velocity that drag leaves after `h`, the way of a unit of it, and of a push."""
    if drag * h < 1e-6:
        return 1.0, h, 0.5 * h * h
    stays = np.exp(-drag * h)
    moves = (1.0 - stays) / drag
    return stays, moves, (h - moves) / drag


@compiled
def advance(cov, steps):
    """Covariance of position, velocity and acceleration a step later, in place; see `coasts`."""
    stays, moves, drifts = steps
    for _ in range(2):  # F cov F': rows, then, transposed, columns
        for k in range(3):
            cov[0, k] += moves * cov[1, k] + drifts * cov[2, k]
            cov[1, k] = stays * cov[1, k] + moves * cov[2, k]
        for i in range(3):
            for k in range(i):
                cov[i, k], cov[k, i] = cov[k, i], cov[i, k]


@compiled
def gain_of(cov, sees, noise):
    """Gain of position, velocity and acceleration for a mean pose, and its variance."""
    one, two = sees
    position = cov[0, 0] + one * cov[0, 1] + two * cov[0, 2]
    velocity = cov[0, 1] + one * cov[1, 1] + two * cov[1, 2]
    slope = cov[0, 2] + one * cov[1, 2] + two * cov[2, 2]
    variance = position + one * velocity + two * slope + noise
    return (position / variance, velocity / variance, slope / variance), variance


def known_of(
    vehicle: Vehicle, mocap: Mocap, bumps: float, tolerances: tuple[float, ...], hardest: Array
) -> Known:
    """Constants of a vehicle that is seen by these cameras.

    Args:
        vehicle: the vehicle.
        mocap: the cameras.
        bumps: variation of the slope over the table [m/s^2].
        tolerances: of a jet's thrust, relative, of its direction [rad], of the inertia, relative,
            and of the centre of mass [m].
        hardest: largest acceleration that is the jets' [m/s^2, rad/s^2].
    """
    thrust, direction, inertia, balance = tolerances
    n, (x, y) = len(vehicle.jets), vehicle.com
    sure = np.array([thrust] * n + [direction] * n + [inertia, balance, balance]) ** -2.0
    turned = [
        jet.thrust * ((jet.position[0] - x) * jet.push[0] + (jet.position[1] - y) * jet.push[1])
        for jet in vehicle.jets
    ]
    period, turn = max(LOOK, mocap.frame_s), np.radians(mocap.noise_deg) ** 2
    return Known(
        vehicle.com,
        np.array([mocap.noise**2 + (x * x + y * y) * turn, turn]) + 1e-16,
        vehicle.tolerance.pulse, bumps * bumps / CELL, sure, np.array(turned), pads_of(vehicle),
        twist_of(vehicle), hardest, period, 1.0 - min(0.5, FORGETS * period / MEMORY_S),
        1.0 - min(0.5, FORGETS * period / STAYS_S),
    )  # fmt: skip
