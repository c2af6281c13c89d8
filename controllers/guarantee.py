"""Conditions of a law's proof that the start of an experiment violates.

The bounded laws have a `certificate`, which is called with the start in the paper's units. The laws
of xue2021 and gao2022 have conditions of their own. The module also checks what
every formation law assumes: edges of the start are no longer than the range, and the desired
distances are geometrically possible.

Violations are `Concern`s, because the law can still be flown. What cannot be flown at all, such as
a list of edges that is not connected, is an error of `graph`.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.bifurcating import BifurcatingParams
from controllers.bounded_formation import BoundedFormationParams
from controllers.bounded_leader import BoundedLeaderParams
from controllers.bounded_leader_varying import BoundedLeaderVaryingParams
from controllers.catalogue import Controller
from controllers.certificate import certificate, sgn_certificate, starting
from controllers.collision_sliding import CollisionSlidingParams
from controllers.connectivity_dynamic import ConnectivityDynamicParams
from controllers.connectivity_static import ConnectivityStaticParams
from controllers.formation_potential import FormationPotential, add_gradient, formation_potential
from controllers.graph import LEADER, Formation, formation, unreached
from controllers.log_potential import log_potential, repulsion
from controllers.proxy import coupling
from testbed.core.law import Concern, Discs

Array = NDArray[np.float64]

Bounded = BoundedFormationParams | BoundedLeaderParams | BoundedLeaderVaryingParams
Unbounded = ConnectivityStaticParams | ConnectivityDynamicParams | CollisionSlidingParams
REACHED = 1e-3  # relative error at which a desired distance counts as reached
TRIES = 8  # initial guesses of the search for a shape, first the experiment's own start


class InitialState(NamedTuple):
    """Start of an experiment, all vehicles at rest; rows in the order of `Body.vehicle_index`."""

    mass: Array  # (n,) [kg]
    p: Array  # (n, d) [m]
    goal_p: Array  # (n, d); the leader's position for those that hear one [m]
    goal_v: Array  # (n, d) [m/s]
    goal_accel: float  # largest of the run [m/s^2]
    max_force: float  # norm of the force of the weakest satellite [N]
    obstacles: Discs


def concerns(params: Controller, names: Sequence[str], start: InitialState) -> list[Concern]:
    """All conditions of the proof that this start violates; empty for laws without a proof."""
    if isinstance(params, BifurcatingParams):
        return _field(params)
    if not isinstance(params, Bounded | Unbounded):
        return []
    s = params.scale
    mass = np.full_like(start.mass, s.mass) if s.mass else start.mass
    accel, speed = s.length / s.time**2, s.length / s.time
    obstacles = start.obstacles
    scaled = InitialState(
        mass, start.p * s.length, start.goal_p * s.length, start.goal_v * speed,
        start.goal_accel * accel, start.max_force * accel * float(np.min(mass / start.mass)),
        Discs(obstacles.p * s.length, obstacles.v * speed, obstacles.radius * s.length),
    )  # fmt: skip
    if isinstance(params, Bounded):
        return _bounded(params, names, scaled)
    shape = formation(params.formation, names)
    return [
        *_edges(shape, names, scaled, params.formation.safe),
        *_unbounded(params, scaled),
        *_demand(params, names, scaled),
        *_shape(shape, names, scaled),
    ]


def _unbounded(params: Unbounded, start: InitialState) -> list[Concern]:
    """Conditions of the theorems of xue2021 on gains and obstacles."""
    found = []
    if isinstance(params, ConnectivityStaticParams) and (start.obstacles.v != 0.0).any():
        found.append(Concern("obstacle-moves", "Theorem 1 requires obstacles that stand still"))
    if isinstance(params, ConnectivityDynamicParams):
        text = (
            f"Theorem 2 requires beta, {params.beta:.4g} N, to exceed mass times the rate of v hat "
            "during the entire flight, which cannot be checked at the start"
        )
        found.append(Concern("beta-unproven", text))
        if params.layer > 0.0:
            text = f"the proof is for sgn; inside a layer of {params.layer:.4g} m/s V may grow"
            found.append(Concern("boundary-layer", text))
    return found


def _demand(params: Unbounded, names: Sequence[str], start: InitialState) -> list[Concern]:
    """Force that the potential asks for at the start; xue2021's theorems assume no limit."""
    if isinstance(params, CollisionSlidingParams):
        return []  # its force is not the gradient
    u = formation_potential(params.potential, params.formation, names)
    wanted = np.zeros_like(start.p)
    obstacles, bodies = start.obstacles, range(len(start.p))
    for i in bodies:
        slopes = [(start.p[j], _pull(u, start.p, i, j)) for j in bodies if j != i]
        slopes += [
            (p, _push(u, start.p[i], p, safe))
            for p, safe in zip(obstacles.p, obstacles.radius, strict=True)
        ]
        for there, slope in slopes:
            x = float(np.linalg.norm(start.p[i] - there))
            add_gradient(slope, start.p[i], there, x, wanted[i])
    worst = int(np.argmax(np.linalg.norm(wanted, axis=1)))
    most = float(np.linalg.norm(wanted[worst]))
    if most <= start.max_force:
        return []
    text = (
        f"at the start the potential asks {names[worst]} for {most:.4g} N, the limit is "
        f"{start.max_force:.4g} N: the force is cut, which the proof does not cover"
    )
    return [Concern("demand-beyond-thrust", text)]


def _pull(u: FormationPotential, p: Array, i: int, j: int) -> float:
    """Slope of a pair's potential [N]; 0 out of range."""
    x: Any = np.linalg.norm(p[i] - p[j])
    held = bool(u.formation.first[i, j] > 0.0)
    if x >= u.formation.range:
        return 0.0
    return float(u.pairs * log_potential(u.single, x, u.formation.desired[i, j], held)[1])


def _push(u: FormationPotential, here: Array, there: Array, safe: float) -> float:
    """Slope of an obstacle's potential [N]."""
    x: Any = np.linalg.norm(here - there)
    return float(u.obstacles * repulsion(u.single, x, safe + u.band, safe)[1]) if u.band else 0.0


def _field(params: BifurcatingParams) -> list[Concern]:
    """Conditions on gao2022's field for the cluster to come to rest."""
    still = [k for k, phase in enumerate(params.phases) if params.field(phase).k_v == 0.0]
    if not still:
        return []
    text = f"k_v = 0 in phases[{still[0]}]: without damping the cluster oscillates forever"
    return [Concern("no-damping", text)]


def _bounded(params: Bounded, names: Sequence[str], start: InitialState) -> list[Concern]:
    led = not isinstance(params, BoundedFormationParams)
    c = coupling(params.proxy, params.formation, names, led)
    shape, found = c.formation, []
    nowhere = np.zeros(start.p.shape[1])
    leader_p, leader_v = nowhere, nowhere
    if led:
        hears = np.flatnonzero(shape.first[-1, :-1] > 0.0)
        leader_p, leader_v = start.goal_p[hears[0]], start.goal_v[hears[0]]
        if np.ptp(start.goal_p[hears], axis=0).any() or np.ptp(start.goal_v[hears], axis=0).any():
            who = ", ".join(names[k] for k in hears.tolist())
            text = f"{who} hear the leader, which is their common goal, but their goals differ"
            found.append(Concern("several-leaders", text))
    fleet = starting(start.mass, start.p, np.zeros_like(start.p), leader_p, leader_v)
    found += _edges(shape, names, start, params.formation.safe)
    found += certificate(c, fleet, start.max_force, start.obstacles, names)
    if isinstance(params, BoundedLeaderVaryingParams):
        given = params.alpha, params.beta, params.layer
        found += sgn_certificate(c, *given, start.mass, start.goal_accel)
    elif isinstance(params, BoundedLeaderParams) and start.goal_accel and not params.feed_forward:
        text = f"the proof is for a constant velocity; this leader has {start.goal_accel:.2g} m/s^2"
        found.append(Concern("leader-accelerates", text))
    if c.band > 0.0 and (start.obstacles.v != 0.0).any():
        found.append(Concern("obstacle-moves", "the proof requires obstacles that stand still"))
    return [*found, *_shape(shape, names, start)]


def _edges(
    shape: Formation, names: Sequence[str], start: InitialState, safe: float
) -> list[Concern]:
    """Edges of the start that are beyond the range, too short or not connected."""
    n, found, edges = len(names), [], shape.first[:-1, :-1].copy()
    for i, j in np.argwhere(np.triu(edges) > 0.0).tolist():
        x = float(np.linalg.norm(start.p[i] - start.p[j]))
        if x >= shape.range:
            edges[i, j] = edges[j, i] = 0.0
            text = (
                f"the edge {names[i]}-{names[j]} starts {x:.4g} m long, beyond the range of "
                f"{shape.range:.4g} m: it is lost at once"
            )
            found.append(Concern("edge-beyond-range", text))
        elif x <= safe:
            text = f"{names[i]} and {names[j]} start {x:.4g} m apart, not more than {safe:.4g} m"
            found.append(Concern("start-too-near", text))
    if found and not shape.first[-1].any() and (alone := unreached(edges)):
        whom = ", ".join(names[k] for k in alone if k < n)
        text = f"no path of edges that can be heard leads from {names[0]} to {whom}"
        found.append(Concern("start-not-connected", text))
    return found


def _shape(shape: Formation, names: Sequence[str], start: InitialState) -> list[Concern]:
    """Desired distances, including those to the leader, that are geometrically impossible."""
    n, d = len(start.p) + 1, start.p.shape[1]
    wanted = np.triu(shape.desired, 1)
    pairs = np.argwhere((wanted > 0.0) & ((wanted < shape.far) | (shape.first > 0.0)))
    if len(pairs) < 2:
        return []
    i, j = pairs.T
    goal = wanted[i, j]

    from scipy.optimize import least_squares  # takes a third of a second to import

    def off(flat: Array) -> Array:
        p = flat.reshape(n, d)
        return (np.linalg.norm(p[i] - p[j], axis=1) - goal) / goal

    rng = np.random.default_rng(0)
    worst, pair = np.inf, 0
    for k in range(TRIES):
        begin = np.vstack([start.p, start.goal_p[:1]])
        begin = begin if k == 0 else goal.max() * rng.normal(size=(n, d))
        rest = np.abs(off(least_squares(off, begin.ravel()).x))
        if rest.max() < worst:
            worst, pair = float(rest.max()), int(np.argmax(rest))
        if worst < REACHED:
            return []
    one, two = [*names, LEADER][i[pair]], [*names, LEADER][j[pair]]
    text = (
        f"no {len(np.unique(pairs))} positions satisfy all desired distances; in the best found "
        f"{one}-{two} = {goal[pair]:.4g} m is {100.0 * worst:.2g} % off"
    )
    return [Concern("unreachable-distances", text)]
