r"""Some satellites under one law, in orbit or nowhere, hearing each other at once: compiled RK4.

The papers' simulations know no radio, no estimator and no jets. Every satellite's law is asked in
every stage; it sees its own state and what the others are and tell at that instant. What is not
continuous (who is whose neighbour) changes between steps. The step is fixed because some of the
laws have sgn in them.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_twin.orbit.relative import Chief, coriolis, drift_rate, field, frame_at
from testbed.core.compiled import compiled
from testbed.core.law import Body, Discs, Goal, Neighbours, World, jump_of, rate_of, tell_of

Array = NDArray[np.float64]

BEFORE = (0.0, 0.5, 0.5, 1.0, 0.0)  # Runge and Kutta's: when a stage is, in steps
SHARE = (1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0)  # of a stage in the step


class Wave(NamedTuple):
    """A vector over time: mean + sine sin(w t) + cosine cos(w t)."""

    mean: Array  # (d,)
    sine: Array  # (d,)
    cosine: Array  # (d,)
    w: float  # [rad/s], > 0


class Place(NamedTuple):
    """Everything round the satellites that is not one of them."""

    orbiting: bool
    chief: Chief  # of the frame, if orbiting
    goal: Array  # (d,) where the goal, or the leader, is at time 0 [m]
    goal_v: Wave  # its velocity [m/s]
    rocks: Array  # (k, d) obstacles at time 0 [m]
    rocks_v: Wave  # the velocity of all of them [m/s]
    radius: Array  # (k,) of them [m]
    push: Wave  # acceleration that no law knows of [m/s^2]
    told_sign: float  # of g as the laws believe it to be; 1: as it is
    told_coriolis: float  # 1: what a law calls drift has C p' in it, 0: not
    told_rate: bool  # laws are told how their drift changes
    near: float  # Eq. (2) of xue2022 to the letter: an edge between two satellites
    far: float  # is there in (near, far) and nowhere else; far = 0: the laws' own graph [m]
    edges_at: int  # where in a law's state a_ij begins
    max_axis: float  # what a thruster can do on each axis [N]


class Flight(NamedTuple):
    """At m times, for n satellites in d dimensions."""

    t: Array  # (m,) [s]
    p: Array  # (m, n, d) [m]
    v: Array  # (m, n, d) [m/s]
    z: Array  # (m, n, k) the laws' states
    wanted: Array  # (m, n, d) force, before the thrusters' bound [N]
    peak: Array  # (n, d) largest |wanted| of all steps [N]
    travel: Array  # (n, d) how much the applied force went up and down in all [N]


@compiled
def wave_at(wave, t):
    """Value, shape (d,)."""
    return wave.mean + wave.sine * np.sin(wave.w * t) + wave.cosine * np.cos(wave.w * t)


@compiled
def wave_integral(wave, t):
    """Integral from 0 to t, shape (d,)."""
    s, c = np.sin(wave.w * t), np.cos(wave.w * t)
    return wave.mean * t + (wave.sine * (1.0 - c) + wave.cosine * s) / wave.w


@compiled
def goal_at(place, t):
    """Where goal or leader is at time `t`, and its derivatives."""
    wave = place.goal_v
    s, c = np.sin(wave.w * t), np.cos(wave.w * t)
    a = wave.w * (wave.sine * c - wave.cosine * s)
    jerk = -wave.w * wave.w * (wave.sine * s + wave.cosine * c)
    return Goal(place.goal + wave_integral(wave, t), wave_at(wave, t), a, jerk)


@compiled
def world_at(place, t):
    """What the laws see besides each other."""
    rocks, speed = place.rocks.copy(), np.zeros_like(place.rocks)
    way, v = wave_integral(place.rocks_v, t), wave_at(place.rocks_v, t)
    for k in range(rocks.shape[0]):
        rocks[k] += way
        speed[k] = v
    return World(goal_at(place, t), Discs(rocks, speed, place.radius))


@compiled
def drifts(place, t, p, v, true, told):
    """Write the acceleration without thrust, as it is and as the laws are told; all (n, d)."""
    true[:], told[:] = 0.0, 0.0
    if place.orbiting:
        frame = frame_at(place.chief, t)
        for i in range(p.shape[0]):
            g, c = field(frame, p[i]), coriolis(frame, v[i])
            true[i] = g + c
            told[i] = place.told_sign * g + place.told_coriolis * c
    push = wave_at(place.push, t)
    for i in range(p.shape[0]):
        true[i] += push


@compiled
def others_of(i, t, p, v, said):
    """Everybody but the i-th."""
    n, d = p.shape
    q, w, word = np.empty((n - 1, d)), np.empty((n - 1, d)), np.empty((n - 1, said.shape[1]))
    who = np.empty(n - 1, dtype=np.int64)
    for k in range(n - 1):
        j = k if k < i else k + 1
        q[k], w[k], word[k], who[k] = p[j], v[j], said[j], j
    return Neighbours(q, w, np.ones(n - 1), who, word, np.full(n - 1, t))


@compiled
def flow(law, place, mass, t, p, v, z, said, a, z_rate, wanted):
    """Write accelerations, rates of the laws' states and forces at one instant."""
    n, d = p.shape
    true, told, still = np.empty((n, d)), np.empty((n, d)), np.zeros(d)
    drifts(place, t, p, v, true, told)
    world = world_at(place, t)
    silent = np.zeros((n, 0))
    if said.shape[1] > 0:
        for i in range(n):
            own = Body(p[i], v[i], mass[i], told[i], still, np.inf, i)
            said[i] = tell_of(law, z[i], own, others_of(i, t, p, v, silent), world, t)
    for i in range(n):
        others = others_of(i, t, p, v, said)
        jolt = still
        for _ in range(2 if place.told_rate else 1):  # one call in the text: half to compile
            own = Body(p[i], v[i], mass[i], told[i], jolt, np.inf, i)
            force, change = rate_of(law, z[i], own, others, world, t)
            wanted[i], z_rate[i] = force, change
            if place.told_rate:  # needs the force, which in these laws does not need it
                accel = told[i] + force / mass[i]
                jolt = drift_rate(frame_at(place.chief, t), p[i], v[i], accel)
        a[i] = np.clip(wanted[i], -place.max_axis, place.max_axis) / mass[i] + true[i]


@compiled
def jump(law, place, mass, t, p, v, z):
    """The laws' states after what changes at once."""
    n, d = p.shape
    after, silent, still = z.copy(), np.zeros((n, 0)), np.zeros(d)
    world = world_at(place, t)
    for i in range(n):
        own = Body(p[i], v[i], mass[i], still, still, np.inf, i)
        after[i] = jump_of(law, z[i], own, others_of(i, t, p, v, silent), world, t)
        if place.far > 0.0:
            for j in range(n):
                gap = np.sqrt(np.sum((p[i] - p[j]) ** 2))
                edge = i != j and place.near < gap < place.far
                after[i, place.edges_at + j] = 1.0 if edge else 0.0
    return after


@compiled
def run(law, place, mass, p, v, z, words, h, steps, every):
    """See `fly`."""
    n, d = p.shape
    m = steps // every + 1
    ts, ps, vs = np.empty(m), np.empty((m, n, d)), np.empty((m, n, d))
    zs, fs = np.empty((m, n, z.shape[1])), np.empty((m, n, d))
    peak, travel, last = np.zeros((n, d)), np.zeros((n, d)), np.zeros((n, d))
    said, f, first = np.zeros((n, words)), np.empty((n, d)), np.empty((n, d))
    a, k = np.zeros((n, d)), np.zeros(z.shape)
    for step in range(steps + 1):
        t = step * h  # not summed up: no drift
        z = jump(law, place, mass, t, p, v, z)
        p1, v1, z1 = p, v, z
        dp, dv, dz = np.zeros_like(p), np.zeros_like(v), np.zeros_like(z)
        for stage in range(4):
            flow(law, place, mass, t + BEFORE[stage] * h, p1, v1, z1, said, a, k, f)
            if stage == 0:
                first[:] = f
            dp, dv, dz = dp + SHARE[stage] * v1, dv + SHARE[stage] * a, dz + SHARE[stage] * k
            ahead = BEFORE[stage + 1] * h
            p1, v1, z1 = p + ahead * v1, v + ahead * a, z + ahead * k
        now = np.clip(first, -place.max_axis, place.max_axis)
        if step > 0:
            travel += np.abs(now - last)
        last = now
        peak = np.maximum(peak, np.abs(first))
        if step % every == 0:
            q = step // every
            ts[q], ps[q], vs[q], zs[q], fs[q] = t, p, v, z, first
        p, v, z = p + h * dp, v + h * dv, z + h * dz
    return ts, ps, vs, zs, fs, peak, travel


def fly(
    law: Any, place: Place, mass: Array, p: Array, v: Array, *, step: float, steps: int, every: int
) -> Flight:
    """Fly for `steps` times `step` [s] and keep one state in `every`.

    Args:
        law: with compiled gains, see `testbed.core.law.CompiledLaw`.
        place: where.
        mass: (n,) [kg].
        p: (n, d) at the start [m].
        v: (n, d) [m/s].
        step: [s].
        steps: how many; `every` divides it.
        every: one in so many is kept.
    """
    still = np.zeros(p.shape[1])
    bodies = [Body(p[i], v[i], float(mass[i]), still, still, np.inf, i) for i in range(len(p))]
    z = np.array([law.initial(own, None, None) for own in bodies])
    return Flight(*run(law.gains, place, mass, p, v, z, law.words, step, steps, every))
