r"""Satellites under one law, in orbit or free space, with ideal communication: compiled RK4.

The papers' simulations include no radio, estimator or jets. Every stage evaluates the law of every
satellite with its own state and the present states and messages of the others. Discontinuous
states, such as edges, change between steps. The step is fixed because some laws contain sgn.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_twin.orbit.relative import Chief, coriolis, drift_rate, field, frame_at
from testbed.core.compiled import borrowed, compiled, keep, pasted
from testbed.core.law import Body, Discs, Goal, Neighbours, World
from testbed.core.law_verbs import broadcast_of, jump_of, write_rate

Array = NDArray[np.float64]

BEFORE = (0.0, 0.5, 0.5, 1.0, 0.0)  # times of the Runge-Kutta stages [steps]
SHARE = (1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0)  # weights of the stages


class Wave(NamedTuple):
    """A vector over time: mean + sine sin(w t) + cosine cos(w t)."""

    mean: Array  # (d,)
    sine: Array  # (d,)
    cosine: Array  # (d,)
    w: float  # [rad/s], > 0


class Place(NamedTuple):
    """The environment of the satellites, for compiled code."""

    orbiting: bool
    chief: Chief  # of the frame, if orbiting
    goal: Array  # (d,) position of the goal, or the leader, at time 0 [m]
    goal_v: Wave  # its velocity [m/s]
    obstacles: Array  # (k, d) obstacles at time 0 [m]
    obstacles_v: Wave  # the velocity of all of them [m/s]
    radius: Array  # (k,) of them [m]
    push: Wave  # acceleration in addition to the orbit's [m/s^2]
    law_g_sign: float  # sign of g in the drift given to the laws; 1: correct
    law_knows_coriolis: float  # 1: the drift given to the laws includes C p', 0: it does not
    law_knows_rate: bool  # laws get the rate of their drift
    law_knows_push: bool  # the drift given to the laws includes `push`
    near: float  # Eq. (2) of xue2022 as printed: two satellites have an edge
    far: float  # exactly if their distance is in (near, far); far = 0: the laws' own graph [m]
    edges_at: int  # index of the first a_ij in a law's state
    max_axis: float  # force limit on each axis [N]


class FleetFlight(NamedTuple):
    """A flight at m times, for n satellites in d dimensions."""

    t: Array  # (m,) [s]
    p: Array  # (m, n, d) [m]
    v: Array  # (m, n, d) [m/s]
    z: Array  # (m, n, k) the laws' states
    wanted: Array  # (m, n, d) force, before the thrusters' limit [N]
    peak: Array  # (n, d) largest |wanted| of all steps [N]
    travel: Array  # (n, d) total variation of the applied force [N]


class Sight(NamedTuple):
    """Inputs of the laws at one time, and work memory."""

    world: World
    others: Neighbours  # of the satellite being evaluated
    unheard: Neighbours  # the same without messages
    drift: Array  # (n, d) acceleration without thrust [m/s^2]
    known: Array  # (n, d) the drift given to the laws [m/s^2]
    still: Array  # (d,) zeros
    jolt: Array  # (d,) rate of the given drift of the satellite being evaluated [m/s^3]


@compiled
def wave_at(wave, t):
    """Value of a wave at time `t`, shape (d,)."""
    out = np.empty(wave.mean.shape[0])
    write_wave(wave, t, out)
    return out


@compiled
def write_wave(wave, t, out):
    """Write the value of a wave to `out`."""
    s, c = np.sin(wave.w * t), np.cos(wave.w * t)
    for a in range(out.shape[0]):
        out[a] = wave.mean[a] + wave.sine[a] * s + wave.cosine[a] * c


@compiled
def wave_integral(wave, t):
    """Integral of a wave from 0 to t, shape (d,)."""
    out = np.empty(wave.mean.shape[0])
    write_integral(wave, t, out)
    return out


@compiled
def write_integral(wave, t, out):
    """Write the integral of a wave to `out`."""
    s, c = np.sin(wave.w * t), np.cos(wave.w * t)
    for a in range(out.shape[0]):
        swing = wave.sine[a] * (1.0 - c) + wave.cosine[a] * s
        out[a] = wave.mean[a] * t + swing / wave.w


@compiled
def goal_at(place, t):
    """Position of goal or leader at time `t`, and its derivatives."""
    d = place.goal.shape[0]
    goal = Goal(np.empty(d), np.empty(d), np.empty(d), np.empty(d))
    write_goal(place, t, goal)
    return goal


@compiled
def write_goal(place, t, goal):
    """Write `goal_at` to `goal`."""
    wave = place.goal_v
    write_integral(wave, t, goal.p)
    write_wave(wave, t, goal.v)
    s, c = np.sin(wave.w * t), np.cos(wave.w * t)
    for a in range(goal.p.shape[0]):
        goal.p[a] += place.goal[a]
        goal.a[a] = wave.w * (wave.sine[a] * c - wave.cosine[a] * s)
        goal.jerk[a] = -wave.w * wave.w * (wave.sine[a] * s + wave.cosine[a] * c)


@compiled
def empty_sight(place, n, words):
    """Allocate the inputs of a law, which are written before each call."""
    d, k = place.goal.shape[0], place.obstacles.shape[0]
    goal = Goal(np.empty(d), np.empty(d), np.empty(d), np.empty(d))
    world = World(goal, Discs(np.empty((k, d)), np.empty((k, d)), place.radius))
    p, v, message_t = np.empty((n - 1, d)), np.empty((n - 1, d)), np.empty(n - 1)
    near, who = np.ones(n - 1), np.empty(n - 1, dtype=np.int64)
    return Sight(
        world,
        Neighbours(p, v, near, who, np.empty((n - 1, words)), message_t),
        Neighbours(p, v, near, who, np.empty((n - 1, 0)), message_t),
        np.empty((n, d)), np.empty((n, d)), np.zeros(d), np.empty(d),
    )  # fmt: skip


@compiled
def write_environment(place, t, sight):
    """Write the environment, common to all laws."""
    goal, obstacles = sight.world.goal, sight.world.obstacles
    write_goal(place, t, goal)
    for k in range(obstacles.p.shape[0]):
        write_integral(place.obstacles_v, t, obstacles.p[k])
        write_wave(place.obstacles_v, t, obstacles.v[k])
        for a in range(obstacles.p.shape[1]):
            obstacles.p[k, a] += place.obstacles[k, a]


@compiled
def look_at_others(i, t, p, v, messages, others):
    """Write states and messages of all satellites except the i-th."""
    for k in range(others.vehicle_index.shape[0]):
        j = k if k < i else k + 1
        others.vehicle_index[k], others.message_t[k] = j, t
        for a in range(p.shape[1]):
            others.p[k, a], others.v[k, a] = p[j, a], v[j, a]
        for a in range(others.message.shape[1]):
            others.message[k, a] = messages[j, a]


@compiled
def drifts(place, t, p, v, true, known):
    """Write the acceleration without thrust, true and as given to the laws; all (n, d)."""
    true[:] = 0.0
    known[:] = 0.0
    if place.orbiting:
        frame = frame_at(place.chief, t)
        for i in range(p.shape[0]):
            g, c = field(frame, p[i]), coriolis(frame, v[i])
            for a in range(p.shape[1]):
                true[i, a] = g[a] + c[a]
                known[i, a] = place.law_g_sign * g[a] + place.law_knows_coriolis * c[a]
    push = wave_at(place.push, t)
    for i in range(p.shape[0]):
        for a in range(p.shape[1]):
            true[i, a] += push[a]
            if place.law_knows_push:
                known[i, a] += push[a]


@compiled
def jolt(place, t, p, v, known, force, mass, out):
    """Write the rate of the drift of one satellite, shape (d,) [m/s^3]."""
    accel = np.empty(p.shape[0])
    for a in range(p.shape[0]):
        accel[a] = known[a] + force[a] / mass
    rate = drift_rate(frame_at(place.chief, t), p, v, accel)
    for a in range(p.shape[0]):
        out[a] = rate[a]


@pasted
def flow(law, place, mass, t, p, v, z, messages, sight, a, z_rate, wanted):
    """Write accelerations, rates of the laws' states and forces at one time."""
    law, place, sight = borrowed(law), borrowed(place), borrowed(sight)
    mass, p, v, z, messages = borrowed((mass, p, v, z, messages))
    known, still = sight.known, sight.still
    drifts(place, t, p, v, sight.drift, known)
    write_environment(place, t, sight)
    n, d = p.shape
    if messages.shape[1] > 0:
        for i in range(n):
            look_at_others(i, t, p, v, messages, sight.unheard)
            own = Body(p[i], v[i], mass[i], known[i], still, np.inf, i)
            word = broadcast_of(law, z[i], own, sight.unheard, sight.world, t)
            for k in range(messages.shape[1]):
                messages[i, k] = word[k]
    for i in range(n):
        look_at_others(i, t, p, v, messages, sight.others)
        sight.jolt[:] = 0.0
        for _ in range(2 if place.law_knows_rate else 1):  # one call site halves compile time
            own = Body(p[i], v[i], mass[i], known[i], sight.jolt, np.inf, i)
            write_rate(law, z[i], own, sight.others, sight.world, t, wanted[i], z_rate[i])
            if (
                place.law_knows_rate
            ):  # depends on the force, which in these laws does not depend on it
                jolt(place, t, p[i], v[i], known[i], wanted[i], mass[i], sight.jolt)
        for k in range(d):
            applied = within(wanted[i, k], place.max_axis)
            a[i, k] = applied / mass[i] + sight.drift[i, k]


@compiled
def within(force, limit):
    """Force limited to the thrusters' range [N]."""
    return min(max(force, -limit), limit)


@pasted
def jump(law, place, mass, t, p, v, z, sight, after):
    """Write the laws' states after discontinuous changes."""
    law, place, sight = borrowed(law), borrowed(place), borrowed(sight)
    mass, p, v, z = borrowed((mass, p, v, z))
    write_environment(place, t, sight)
    for i in range(p.shape[0]):
        look_at_others(i, t, p, v, z, sight.unheard)
        own = Body(p[i], v[i], mass[i], sight.still, sight.still, np.inf, i)
        new = jump_of(law, z[i], own, sight.unheard, sight.world, t)
        for k in range(z.shape[1]):
            after[i, k] = new[k]
        if place.far > 0.0:
            edges_as_printed(place, i, p, after)


@compiled
def edges_as_printed(place, i, p, z):
    """Write the edges of the i-th satellite, Eq. (2) of xue2022 as printed."""
    for j in range(p.shape[0]):
        square = 0.0
        for a in range(p.shape[1]):
            square += (p[i, a] - p[j, a]) ** 2
        edge = i != j and place.near < np.sqrt(square) < place.far
        z[i, place.edges_at + j] = 1.0 if edge else 0.0


@compiled
def copy(x, out):
    """Copy x to `out`; a loop compiles faster than `out[:] = x`, which checks shapes."""
    for i in range(x.shape[0]):
        for k in range(x.shape[1]):
            out[i, k] = x[i, k]


@compiled
def add(total, share, rate):
    """Add `share` times `rate` to `total`, both (n, k)."""
    for i in range(total.shape[0]):
        for k in range(total.shape[1]):
            total[i, k] += share * rate[i, k]


@compiled
def ahead(x, h, rate, out):
    """Write x + h rate, all (n, k)."""
    for i in range(x.shape[0]):
        for k in range(x.shape[1]):
            out[i, k] = x[i, k] + h * rate[i, k]


@compiled
def keep_score(limit, wanted, first, last, peak, travel):
    """Update the largest force and the total variation of the applied force, `last`."""
    for i in range(wanted.shape[0]):
        for k in range(wanted.shape[1]):
            now = within(wanted[i, k], limit)
            if not first:
                travel[i, k] += abs(now - last[i, k])
            last[i, k] = now
            peak[i, k] = max(peak[i, k], abs(wanted[i, k]))


@compiled
def run(law, place, mass, p, v, z, words, h, steps, every):
    """See `fly`; only calls of the law are compiled per law, other functions are shared."""
    n, d = p.shape
    m = steps // every + 1
    ts, ps, vs = np.empty(m), np.empty((m, n, d)), np.empty((m, n, d))
    zs, fs = np.empty((m, n, z.shape[1])), np.empty((m, n, d))
    peak, travel, last = np.zeros((n, d)), np.zeros((n, d)), np.zeros((n, d))
    messages, f, sight = np.zeros((n, words)), np.empty((n, d)), empty_sight(place, n, words)
    a, k, first = np.empty((n, d)), np.empty(z.shape), np.empty((n, d))
    p1, v1, z1 = np.empty((n, d)), np.empty((n, d)), np.empty(z.shape)
    dp, dv, dz = np.empty((n, d)), np.empty((n, d)), np.empty(z.shape)
    p, v, z = p.copy(), v.copy(), z.copy()
    for step in range(steps + 1):
        t = step * h  # not accumulated, to avoid rounding drift
        jump(law, place, mass, t, p, v, z, sight, z1)
        copy(z1, z)
        copy(p, p1)
        copy(v, v1)
        dp[:] = 0.0
        dv[:] = 0.0
        dz[:] = 0.0
        for stage in range(4):
            flow(law, place, mass, t + BEFORE[stage] * h, p1, v1, z1, messages, sight, a, k, f)
            if stage == 0:
                copy(f, first)
            add(dp, SHARE[stage], v1)
            add(dv, SHARE[stage], a)
            add(dz, SHARE[stage], k)
            on = BEFORE[stage + 1] * h
            ahead(p, on, v1, p1)
            ahead(v, on, a, v1)
            ahead(z, on, k, z1)
        keep_score(place.max_axis, first, step == 0, last, peak, travel)
        if step % every == 0:
            q = step // every
            ts[q] = t
            copy(p, ps[q])
            copy(v, vs[q])
            copy(z, zs[q])
            copy(first, fs[q])
        ahead(p, h, dp, p)
        ahead(v, h, dv, v)
        ahead(z, h, dz, z)
    keep((law, place, mass, sight, messages, p, v, z, p1, v1, z1))  # see `pasted`
    return ts, ps, vs, zs, fs, peak, travel


def fly(
    law: Any, place: Place, mass: Array, p: Array, v: Array, *, step: float, steps: int, every: int
) -> FleetFlight:
    """Fly for `steps` times `step` [s] and keep one state in `every`.

    Args:
        law: with compiled gains, see `testbed.core.law.CompiledLaw`.
        place: the environment.
        mass: (n,) [kg].
        p: initial positions, (n, d) [m].
        v: initial velocities, (n, d) [m/s].
        step: step size [s].
        steps: number of steps, a multiple of `every`.
        every: keep every n-th state.
    """
    still = np.zeros(p.shape[1])
    bodies = [Body(p[i], v[i], float(mass[i]), still, still, np.inf, i) for i in range(len(p))]
    z = np.array([law.initial(own, None, None) for own in bodies])
    return FleetFlight(*run(law.gains, place, mass, p, v, z, law.message_size, step, steps, every))
