r"""Model predictive control to a goal that avoids obstacles and the other vehicles.

Sources: J. B. Rawlings, D. Q. Mayne, M. M. Diehl, "Model Predictive Control: Theory, Computation,
and Design", 2nd ed., 2017 (sections 2.3, 8.8: condensing, terminal cost); E. C. Kerrigan, J. M.
Maciejowski, "Soft constraints and exact penalty functions in model predictive control", UKACC
Control 2000; the solver is DAQP: D. Arnstrom, A. Bemporad, D. Axehill, "A dual active-set solver
for embedded quadratic programming using recursive LDL^T updates", IEEE Trans. Automatic Control
67:4362, 2022.

    minimise    sum_k |e_k|^2/error^2 + |e'_k|^2/speed^2 + |a_k - a_steady|^2/accel^2 + e_N'P e_N
                + violation sum_j s_j
    subject to  n.a_k <= limit                for each facet n of the thrust limit
                n_jk.(p_k - c_jk) >= radius_j + margin - s_j,  s_j >= 0

    symbol      code           meaning                                                 unit
    k           0..steps       of the prediction, step_s apart                         -
    a_k         plan           acceleration from k to k + 1, held                      m/s^2
    e_k, e'_k                  error to the predicted goal and its rate                m, m/s
    P                          terminal cost without constraints, see `sampled`
    n_jk        normals        from disc j to the predicted path at k                  -
    c_jk                       predicted centre of disc j, at constant velocity        m
    s_j         slack          violation of the margin of disc j                       m

The allowed half-plane behind a disc's tangent lies outside the disc, so a feasible path is free of
collisions; the tangent turns with the path from decision to decision. It is also tilted by at most
`TILT` towards the side with the shorter way to the goal, because otherwise a vehicle exactly in
line with a disc and its goal would stop in front of the disc for good. Other vehicles are discs,
too, and all vehicles pass each other on the same side.

If a margin cannot be kept, it is violated as little as possible: `violation` exceeds any
constraint's multiplier, so a margin that can be kept is kept (exact penalty). If the solver fails,
the satellite brakes. The law's state counts both and `concerns` reports them.

The law decides once per jet period and is deterministic: each program is warm-started with the
previous plan, which is part of the law's state.

It holds its goal without an offset (G. Pannocchia, J. B. Rawlings, "Disturbance models for
offset-free model-predictive control", AIChE Journal 49:426, 2003): what the velocity does beyond
the plan and the estimator's disturbance is a disturbance of its own, followed with the time
constant `remainder_s`. It stands for jets that give less than the plan assumes.
"""

from typing import Annotated, NamedTuple

import daqp
import numpy as np
from msgspec import Meta, Struct, field
from numpy.typing import NDArray

from controllers.lqr import Feed, check_orbit, steady
from controllers.sampled import Sampled, cost_to_go, generator, sampled, weights
from controllers.scale import Scale
from testbed.core.law import Body, Concern, Law, Neighbours, World, bounded
from testbed.core.vehicle import NonNegative, Positive

Array = NDArray[np.float64]

TILT = 0.1  # [rad]
FEASIBLE = 1e-5  # a program's solution may violate its constraints by that much [m, m/s^2]
NOTICED = 1e-3  # smaller violations of a margin are not reported [m]
BRAKE_S = 0.5  # stopping time of a satellite without a plan, within its force limit [s]
SOLVED = 1  # DAQP's exit flag
FREE = 1e30  # DAQP's infinity
CURVE = 1e-3  # curvature of the slacks' cost: DAQP requires strict convexity
LARGEST_REST = 0.2  # of the force limit: what a blocked or saturated vehicle may add up
FAILED, SOFTENED, WORST, PLAN = 0, 1, 2, 3  # indices into the law's state


class MpcParams(Struct, frozen=True, forbid_unknown_fields=True, tag="mpc"):
    """Weights by Bryson's rule, horizon, margins and the model."""

    error: Positive = 1.0  # [m]
    speed: Positive = 0.1  # [m/s]
    accel: Positive = 0.02  # [m/s^2]
    steps: Annotated[int, Meta(ge=1, le=100)] = 20
    step_s: Positive = 1.0
    margin: NonNegative = 0.05  # beyond the discs' radii [m]
    violation: Positive = 1e4  # cost per metre of violated margin
    feed: Feed = "disturbance"
    remainder_s: NonNegative = 5.0  # only with feed = "disturbance"; 0: off [s]
    mean_motion: NonNegative = 0.0  # [rad/s]
    period: Positive = 0.1  # hold time of a force if the caller does not give one [s]
    scale: Scale = field(default_factory=Scale)

    def __post_init__(self) -> None:
        check_orbit(self.feed, self.mean_motion)


class Horizon(NamedTuple):
    """The prediction x = from_state x_0 + from_plan a, rows in order of time, and its cost."""

    from_state: Array  # (n 2d, 2d)
    from_plan: Array  # (n 2d, n d)
    cost: Array  # (n 2d, n 2d)
    accel: Array  # (n d, n d)
    facets: Array  # (n f, n d), unit normals
    inscribed: float  # distance of the facets from the centre if the body just fits a unit ball


def directions(d: int) -> tuple[Array, float]:
    """Normals of a body around the origin, and their distance when it just fits a unit ball.

    The corners, edges and faces of a cube: an octagon on the table, 26 facets in space. The ball
    touches where w = (1, sqrt 2 - 1, sqrt 3 - sqrt 2)[:d] is, which is equally far from its facets.
    """
    signs = np.array(np.meshgrid(*[[-1.0, 0.0, 1.0]] * d)).reshape(d, -1).T
    size = np.linalg.norm(signs, axis=1)
    corner = np.diff(np.sqrt(np.arange(d + 1)))
    return signs[size > 0.0] / size[size > 0.0, None], 1.0 / float(np.linalg.norm(corner))


def horizon(params: MpcParams, d: int) -> Horizon:
    """Matrices of the prediction, constant over a flight."""
    n, model = params.steps, sampled(params.mean_motion, d, params.step_s)
    cost = weights(params.error, params.speed, params.accel, d)
    powers = [np.eye(2 * d)]
    for _ in range(n):
        powers.append(model.a @ powers[-1])
    from_plan = np.zeros((n, 2 * d, n, d))
    for k in range(n):
        for i in range(k + 1):
            from_plan[k, :, i] = powers[k - i] @ model.b
    whole = repeated(cost.state, n)
    whole[-2 * d :, -2 * d :] = cost_to_go(model, cost)
    normals, inscribed = directions(d)
    return Horizon(
        np.concatenate(powers[1:]), from_plan.reshape(2 * d * n, d * n), whole,
        repeated(cost.accel, n), repeated(normals, n), inscribed,
    )  # fmt: skip


def repeated(block: Array, n: int) -> Array:
    """Block-diagonal matrix with `block` repeated n times."""
    return np.asarray(np.kron(np.eye(n), block), dtype=np.float64)


def tangents(path: Array, centres: Array, goal: Array, others: int = 0) -> Array:
    """Unit normals (m, n, d) of the half-planes that m discs leave to n points of a path.

    Args:
        path: predicted, (n, d) [m].
        centres: of the discs at those times, (m, n, d) [m].
        goal: (d,) [m].
        others: number of discs at the end that are satellites, which avoid this one, too.
    """
    normal = _unit(path - centres, np.eye(path.shape[1])[0])
    beyond = _unit(goal - centres, normal)
    along = np.sum(normal * beyond, axis=2, keepdims=True)
    hand = _hand(normal)
    aside = _unit(beyond - along * normal, hand)
    if others:
        aside[-others:] = hand[-others:]
    tilt = TILT * np.maximum(0.0, -along)
    return np.cos(tilt) * normal + np.sin(tilt) * aside


def _hand(normal: Array) -> Array:
    """Unit vectors across `normal`, always to the same side, so that two vehicles can pass."""
    if normal.shape[-1] == 2:
        return np.stack((-normal[..., 1], normal[..., 0]), axis=-1)
    up = np.where(np.abs(normal[..., 2:]) < 0.9, np.eye(3)[2], np.eye(3)[0])
    across = np.cross(up, normal)
    return _unit(across, across)


def _unit(vectors: Array, otherwise: Array) -> Array:
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(size > 1e-9, vectors / np.maximum(size, 1e-9), otherwise)


class Program(NamedTuple):
    """Minimise z'H z/2 + f.z subject to A z <= upper, z[:m] >= 0; z: m slacks, then the plan."""

    h: Array
    f: Array
    a: Array
    upper: Array
    m: int


class Mpc:
    """The law.

    Its state: solver failures, margin violations, largest violation [m], plan (n d) [m/s^2],
    disturbance beyond the estimator's (d) [m/s^2], velocity expected at the next decision (d)
    [m/s].
    """

    def __init__(self, params: MpcParams, d: int) -> None:
        self._params, self._d, self._n = params, d, params.steps
        self._learns = params.feed == "disturbance" and params.remainder_s > 0.0
        self._generator = generator(params.mean_motion, d)[0]
        self._horizon = ahead = horizon(params, d)
        self._h = 2.0 * (ahead.from_plan.T @ ahead.cost @ ahead.from_plan + ahead.accel)
        self._h = 0.5 * (self._h + self._h.T)

    def initial(self, own: Body, neighbours: Neighbours, world: World) -> Array:
        """See `Law`."""
        return np.concatenate((np.zeros(PLAN + (self._n + 1) * self._d), own.v))

    def _goals(self, own: Body, world: World) -> tuple[Array, Array]:
        """States (n 2d,) of the goal after each step; steady accelerations (n d,) on it."""
        goal, t = world.goal, self._params.step_s * np.arange(self._n + 1)[:, None]
        a, v = goal.a + t * goal.jerk, goal.v + t * goal.a + t**2 / 2.0 * goal.jerk
        p = goal.p + t * goal.v + t**2 / 2.0 * goal.a + t**3 / 6.0 * goal.jerk
        states = np.concatenate((p, v), axis=1)
        accels = steady(self._generator, states, a, own.disturbance, self._params.feed)
        return states[1:].ravel(), accels[:-1].ravel()

    def program(self, plan: Array, own: Body, neighbours: Neighbours, world: World) -> Program:
        """The quadratic program, linearised about the path of `plan` (n d,)."""
        n, d, ahead, params = self._n, self._d, self._horizon, self._params
        goals, accels = self._goals(own, world)
        free = ahead.from_state @ np.concatenate((own.p, own.v))
        if params.feed == "disturbance":
            free += ahead.from_plan @ np.tile(own.disturbance, n)
        f = 2.0 * (ahead.from_plan.T @ (ahead.cost @ (free - goals)) - ahead.accel @ accels)
        path = (free + ahead.from_plan @ plan).reshape(n, 2 * d)[:, :d]
        times = params.step_s * np.arange(1, n + 1)[:, None]
        discs = (world.obstacles, neighbours)
        centres = np.concatenate([one.p[:, None] + times * one.v[:, None] for one in discs])
        radius = np.concatenate([one.radius for one in discs]) + params.margin
        m = len(radius)
        normals = tangents(path, centres, world.goal.p, len(neighbours.radius))
        reach = ahead.from_plan.reshape(n, 2 * d, n * d)[:, :d]
        start = free.reshape(n, 2 * d)[:, :d]
        limit = ahead.inscribed * own.max_force / own.mass
        discs_rows = np.zeros((m * n, m + n * d))
        discs_rows[:, :m] = -np.repeat(np.eye(m), n, axis=0)
        discs_rows[:, m:] = -np.einsum("jki,kiu->jku", normals, reach).reshape(m * n, n * d)
        room = np.einsum("jki,jki->jk", normals, start - centres) - radius[:, None]
        facet_rows = np.concatenate((np.zeros((len(ahead.facets), m)), ahead.facets), axis=1)
        h = np.zeros((m + n * d, m + n * d))
        h[:m, :m], h[m:, m:] = CURVE * np.eye(m), self._h
        return Program(
            h,
            np.concatenate((np.full(m, params.violation), f)),
            np.concatenate((facet_rows, discs_rows)),
            np.concatenate((np.full(len(facet_rows), limit), room.ravel())),
            m,
        )

    def decide(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World, duration: float
    ) -> tuple[Array, Array]:
        """See `Decider`."""
        d, after = self._d, law_state.copy()
        before, _, _ = self._parts(law_state)
        plan_now, rest, expected = self._parts(after)
        if self._learns:
            if np.isfinite(surprise := own.v - expected).all():
                rest += surprise / max(self._params.remainder_s, duration)
            rest[:] = bounded(rest, LARGEST_REST * own.max_force / own.mass)
            own = own._replace(disturbance=own.disturbance + rest)
        program = self.program(before, own, neighbours, world)
        z = solved(program, before)
        if z is None:
            after[FAILED] += 1.0
            a, plan_now[:] = -own.v / max(BRAKE_S, duration) - own.disturbance, 0.0
        else:
            given_up, plan = np.max(z[: program.m], initial=0.0), z[program.m :]
            after[SOFTENED] += given_up > NOTICED
            after[WORST] = max(after[WORST], given_up)
            a, share = plan[:d], min(1.0, duration / self._params.step_s)
            later = np.concatenate((plan[d:], np.zeros(d)))
            plan_now[:] = (1.0 - share) * plan + share * later
        force = bounded(own.mass * a, own.max_force)
        expected[:] = own.v + duration * (force / own.mass + own.disturbance)
        return force, after

    def _parts(self, law_state: Array) -> tuple[Array, Array, Array]:
        """Plan, disturbance beyond the estimator's, expected velocity: views of the state."""
        d = self._d
        return law_state[PLAN : -2 * d], law_state[-2 * d : -d], law_state[-d:]

    def concerns(self, law_state: Array) -> list[Concern]:
        """See `Decider`."""
        found = []
        if law_state[FAILED] > 0.0:
            text = f"the solver failed in {law_state[FAILED]:.0f} decisions: the vehicle braked"
            found.append(Concern("solver-failed", text))
        if law_state[SOFTENED] > 0.0:
            text = (
                f"a margin was violated in {law_state[SOFTENED]:.0f} decisions, by "
                f"{law_state[WORST]:.3f} m at most: it could not be kept"
            )
            found.append(Concern("margin-given-up", text))
        return found


def solved(program: Program, plan: Array) -> Array | None:
    """The solution z, warm-started with `plan`; None if the solver fails."""
    numbers = (program.h, program.f, program.a, program.upper)
    if not all(np.isfinite(part).all() for part in numbers):
        return None
    m = program.m
    upper = np.concatenate((np.full(m, FREE), program.upper))
    lower = np.concatenate((np.zeros(m), np.full(len(program.upper), -FREE)))
    z, _, flag, _ = daqp.solve(
        program.h, program.f, program.a, upper, lower,
        primal_start=np.concatenate((np.zeros(m), plan)),
    )  # fmt: skip
    if flag != SOLVED or not np.isfinite(z).all():
        return None
    over = np.max(program.a @ z - program.upper, initial=0.0)
    return z if max(over, -np.min(z[:m], initial=0.0)) <= FEASIBLE else None


def mpc(params: MpcParams, d: int) -> Law:
    """The law for positions of shape (d,)."""
    return Sampled(Mpc(params, d), params.period)
