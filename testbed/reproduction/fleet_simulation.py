"""xue2021, xue2022, xue2024: formations in orbit that must keep their connectivity.

Measures of a run, where "i-j" is a pair of names and `leader` may be one of them:

    final i-j, longest i-j, shortest i-j    distance [m]
    edges_off_m                             largest gap between an edge and its desired length, end
    edges_settle_s                          after which all edges stay within `settle_m` of it
    edges_longest_m, closest_m              over the run; any pair, the leader's included
    obstacle_m                              smallest distance to an obstacle's centre
    lost_edges                              edges of the start that were out of range or dropped
    obstacle_felt_s                         last time at which an obstacle repels a satellite
    raw_n                                   largest force on any axis, before the thruster's limit
    speed_end                               largest |v - v_leader| in the last hundredth [m/s]
    proxy_m, proxy_end_m, proxy_speed_end   satellite against its proxy
    v0, phi_min, pq, height_needed_m        the certificate; eps/2 with which phi_min = P Q [J, m]
    longer_than_bar_m                       longest first edge less Delta bar
    gravity_n                               largest m |g| during the flight
    v_rise, v_end                           largest rise of V between samples; V at the end / V(0)
    concern <name>                          1 if the certificate raises it, else 0
"""

from itertools import combinations
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from controllers import certificate as proof
from controllers.bounded_leader_varying import BoundedLeaderVaryingParams
from controllers.bounded_potential import inside
from controllers.catalogue import Controller
from controllers.connectivity_static import ConnectivityStaticParams
from controllers.formation_potential import FormationPotential
from controllers.graph import Formation, pinned, smallest_eigenvalue
from controllers.guarantee import Bounded
from controllers.log_potential import log_potential, repulsion
from controllers.proxy import Coupling
from sim_twin.orbit.relative import field, frame_at
from testbed.core.law import CompiledLaw
from testbed.core.vehicle import NonNegative, Positive
from testbed.metrics.formation import settled_after
from testbed.reproduction.compiled_law import gains_of
from testbed.reproduction.figure import Figure
from testbed.reproduction.fleet_figures import Tracks, figures
from testbed.reproduction.kernel.fleet import (
    FleetFlight,
    Place,
    fly,
    goal_at,
    wave_at,
    wave_integral,
)
from testbed.reproduction.scene import NO_OBSTACLES, Leader, Obstacles, OrbitParams, Vector, place
from testbed.reproduction.targets import Measures

Array = NDArray[np.float64]

SAMPLES = 2000  # samples kept of a run
END = 0.01  # share of a run that counts as its end
KINDS = (
    "edge-outside-potential", "start-energy", "barrier-height", "limit-beyond-thrust",
    "alpha-too-small", "beta-too-small", "boundary-layer", "lock-in",
)  # fmt: skip


class Together(Struct, frozen=True, forbid_unknown_fields=True, tag="together"):
    """A simulation of one of the three papers."""

    controller: Controller
    orbit: OrbitParams
    mass: tuple[Positive, ...]  # [kg]
    start: tuple[Vector, ...]  # [m]
    duration_s: Positive
    step_s: Positive
    quick_step_s: Positive
    velocity: tuple[Vector, ...] | None = None  # null: at rest [m/s]
    leader: Leader | None = None
    obstacles: Obstacles = NO_OBSTACLES
    max_axis_n: Positive = 1e9  # force limit of the thrusters on each axis [N]
    settle_m: Positive = 1.0
    literal_graph: tuple[NonNegative, Positive] | None = None  # range of edges [m]
    law_g_sign: float = 1.0  # sign of g in the feed-forward; -1: as printed
    law_knows_coriolis: bool = True
    corrections: tuple[str, ...] = ()
    assumptions: tuple[str, ...] = ()

    @property
    def names(self) -> list[str]:
        """Names of the satellites: their numbers in the paper."""
        return [str(k + 1) for k in range(len(self.mass))]


def formation_of(controller: Controller, law: CompiledLaw) -> tuple[Formation, int]:
    """The law's formation, and the index of the first a_ij in its state, if it has them."""
    gains: Any = law.gains
    if isinstance(controller, Bounded):
        return gains.coupling.formation, 6
    return gains.potential.formation, 1


def band_of(law: CompiledLaw) -> float:
    """Width of an obstacle's repulsion beyond its danger radius [m]."""
    potential = getattr(law.gains, "potential", None)
    return float(getattr(potential, "band", 0.0))


def scene_of(run: Together, edges_at: int) -> Place:
    """The environment of the run."""
    near, far = run.literal_graph or (0.0, 0.0)
    leader = run.leader
    return place(
        run.orbit,
        leader.start if leader else (0.0, 0.0, 0.0),
        leader.velocity if leader else NO_OBSTACLES.velocity,
        run.obstacles,
        law_g_sign=run.law_g_sign, law_knows_coriolis=float(run.law_knows_coriolis),
        near=near, far=far, edges_at=edges_at, max_axis=run.max_axis_n,
    )  # fmt: skip


def tracks_of(
    run: Together, where: Place, shape: Formation, edges_at: int, f: FleetFlight
) -> Tracks:
    """Positions and edges, the leader last; a law without a_ij has those of the start."""
    goals = [goal_at(where, t) for t in f.t]
    p = np.concatenate([f.p, np.array([g.p for g in goals])[:, None]], axis=1)
    v = np.concatenate([f.v, np.array([g.v for g in goals])[:, None]], axis=1)
    n = len(run.mass)
    edge = np.zeros((len(f.t), n + 1, n + 1))
    if f.z.shape[2] >= edges_at + n + 1:
        edge[:, :n] = f.z[:, :, edges_at : edges_at + n + 1]
        edge[:, n, :n] = edge[:, :n, n]
    else:
        edge[:] = shape.first
    return Tracks(f.t, p, v, edge)


def distances(run: Together, shape: Formation, track: Tracks) -> Measures:
    """Measures of distances and edges."""
    names = [*run.names, "leader"]
    found: Measures = {}
    last = track.t >= (1.0 - END) * track.t[-1]
    off, longest, lost = np.zeros(len(track.t)), [], 0
    closest = []
    for i, j in combinations(range(len(names) if run.leader else len(names) - 1), 2):
        gap = np.linalg.norm(track.p[:, i] - track.p[:, j], axis=1)
        pair = f"{names[i]}-{names[j]}"
        found[f"final {pair}"] = [float(gap[last].mean())]
        found[f"longest {pair}"] = [float(gap.max())]
        found[f"shortest {pair}"] = [float(gap.min())]
        closest.append(gap.min())
        if shape.first[i, j] > 0.0:
            off = np.maximum(off, np.abs(gap - shape.desired[i, j]))
            longest.append(gap.max())
            lost += bool(gap.max() >= shape.range or (track.edge[:, i, j] < 0.5).any())
    found["edges_off_m"] = [float(off[last].max())]
    found["edges_settle_s"] = [settled_after(track.t, off > run.settle_m)]
    found["edges_longest_m"] = [float(max(longest))]
    found["closest_m"] = [float(min(closest))]
    found["lost_edges"] = [float(lost)]
    return found


def obstacles(where: Place, track: Tracks, band: float) -> Measures:
    """Smallest distance to obstacles, and the last time within `band` of a danger area."""
    if len(where.obstacles) == 0:
        return {}
    gaps = np.empty(len(track.t))
    for k, t in enumerate(track.t):
        obstacles = where.obstacles + wave_integral(where.obstacles_v, t)
        gaps[k] = np.linalg.norm(track.p[k, :-1, None] - obstacles[None], axis=2).min()
    felt = track.t[gaps < band + float(where.radius.max())]
    return {
        "obstacle_m": [float(gaps.min())],
        "obstacle_felt_s": [float(felt[-1]) if len(felt) else 0.0],
    }


def efforts(run: Together, track: Tracks, f: FleetFlight) -> Measures:
    """Measures of forces and velocities."""
    last = track.t >= (1.0 - END) * track.t[-1]
    relative = track.v[:, :-1] - (track.v[:, -1:] if run.leader else 0.0)
    return {
        "raw_n": [float(f.peak.max())],
        "speed_end": [float(np.linalg.norm(relative[last], axis=2).max())],
        "speed_axis_end": [float(np.abs(relative[last]).max())],
    }


def proxies(track: Tracks, f: FleetFlight) -> Measures:
    """Differences of position and velocity between satellites and proxies."""
    last = track.t >= (1.0 - END) * track.t[-1]
    gap = np.linalg.norm(f.p - f.z[:, :, :3], axis=2)
    slip = np.linalg.norm(f.v - f.z[:, :, 3:6], axis=2)
    return {
        "proxy_m": [float(gap.max())],
        "proxy_end_m": [float(gap[last].max())],
        "proxy_speed_end": [float(slip[last].max())],
    }


def energies(run: Together, c: Coupling, track: Tracks, f: FleetFlight) -> Array:
    """V over a flight, with the edges at each time."""
    mass, still = np.array(run.mass), np.zeros(3)
    led = run.leader is not None
    return np.array(
        [
            proof.energy(
                c,
                proof.ProxyFleet(
                    mass,
                    f.p[k],
                    f.v[k],
                    f.z[k, :, :3],
                    f.z[k, :, 3:6],
                    track.p[k, -1] if led else still,
                    track.v[k, -1] if led else still,
                ),
                track.edge[k],
            )
            for k in range(len(f.t))
        ]
    )


def certificates(run: Together, law: CompiledLaw, params: Bounded) -> Measures:
    """Measures of the proof's conditions."""
    gains: Any = law.gains
    c: Coupling = gains.coupling
    mass, p = np.array(run.mass), np.array(run.start)
    v = np.zeros_like(p) if run.velocity is None else np.array(run.velocity)
    leader = run.leader
    at = np.array(leader.start) if leader else np.zeros(3)
    moving = wave_at(leader.velocity.wave(), 0.0) if leader else np.zeros(3)
    fleet = proof.starting(mass, p, v, at, moving)
    # the papers' thrusters have a limit on each axis
    concerns = proof.certificate(c, fleet, run.max_axis_n * np.sqrt(3.0))
    least, height = proof.least_spring_energy(c), c.weight * c.potential.height
    corner = c.limit / c.spring
    found: Measures = {
        "v0": [proof.energy(c, fleet, c.formation.first)],
        "phi_min": [least],
        "pq": [height],
        "height_needed_m": [height / c.limit + 0.5 * corner],
        "kinetic0": [proof.energy(c, fleet, np.zeros_like(c.formation.first))],
    }
    found |= bars(c, fleet)
    if isinstance(params, BoundedLeaderVaryingParams) and leader:
        accel = leader.top_accel
        concerns += proof.sgn_certificate(c, params.alpha, params.beta, params.layer, mass, accel)
        root = np.sqrt(smallest_eigenvalue(pinned(c.formation.first)))
        gamma = np.sqrt(len(mass)) * accel
        found["alpha_min"], found["beta_min"] = [c.mass * gamma / root], [mass.max() * gamma / root]
        found["mass_max"] = [params.beta * root / gamma]
    raised = {concern.name for concern in concerns}
    return found | {f"concern {kind}": [float(kind in raised)] for kind in KINDS}


def bars(c: Coupling, fleet: proof.ProxyFleet) -> Measures:
    """Delta bar of xue2022, Eq. (18), at which the potentials of initial edges add up to Q."""
    p = np.vstack([fleet.p, fleet.leader_p])
    pairs = np.argwhere(np.triu(c.formation.first) > 0.0)
    beyond = -np.inf
    for i, j in pairs:
        low, high = float(c.formation.desired[i, j]), c.potential.far
        desired = low
        for _ in range(60):  # psi rises from 0 to Q
            middle = 0.5 * (low + high)
            above = len(pairs) * inside(c.potential, middle, desired)[0] > c.potential.height
            low, high = (low, middle) if above else (middle, high)
        beyond = max(beyond, float(np.linalg.norm(p[i] - p[j])) - low)
    return {"longer_than_bar_m": [beyond]}


def gravity(run: Together, where: Place, f: FleetFlight) -> Measures:
    """Largest gravity force, for Assumption 3."""
    frames = [frame_at(where.chief, t) for t in f.t]
    pulls = [
        m * np.linalg.norm(field(frame, p))
        for frame, row in zip(frames, f.p, strict=True)
        for m, p in zip(run.mass, row, strict=True)
    ]
    return {"gravity_n": [float(max(pulls))]}


def static_energy(run: Together, law: CompiledLaw, track: Tracks, f: FleetFlight) -> Array:
    """V_1 of xue2021, Eq. (10), over a flight; psi^d is constant for pairs out of range."""
    gains: Any = law.gains
    u: FormationPotential = gains.potential
    mass, total = np.array(run.mass), np.zeros(len(f.t))
    x: Any
    for k in range(len(f.t)):
        total[k] = 0.5 * mass @ (f.v[k] ** 2).sum(axis=1)
        total[k] += 0.5 / gains.alpha * ((mass - f.z[k, :, 0]) ** 2).sum()
        for i, j in combinations(range(len(mass)), 2):
            x = np.linalg.norm(f.p[k, i] - f.p[k, j])
            x = x if track.edge[k, i, j] > 0.5 else u.single.range
            held = bool(u.formation.first[i, j] > 0.5)
            total[k] += u.pairs * log_potential(u.single, x, u.formation.desired[i, j], held)[0]
        for obstacle in run.obstacles.start:
            for p in f.p[k]:
                x, safe = np.linalg.norm(p - np.array(obstacle)), run.obstacles.radius
                total[k] += u.obstacles * repulsion(u.single, x, safe + u.band, safe)[0]
    return total


def rises(v: Array) -> Measures:
    """Rise of V between samples and its value at the end."""
    return {
        "v_rise": [float(np.diff(v).max(initial=0.0))],
        "v_rise_total": [float(np.maximum(np.diff(v), 0.0).sum())],
        "v_start": [float(v[0])],
        "v_end": [float(v[-1] / v[0])],
    }


def run_together(run: Together, *, quick: bool) -> tuple[Measures, list[Figure]]:
    """Fly once and compute all measures."""
    law = gains_of(run.controller, run.names, 3)
    shape, edges_at = formation_of(run.controller, law)
    where = scene_of(run, edges_at)
    step = run.quick_step_s if quick else run.step_s
    steps = round(run.duration_s / step)
    every = max(1, steps // SAMPLES)
    start = np.array(run.start)
    v = np.zeros_like(start) if run.velocity is None else np.array(run.velocity)
    f = fly(
        law, where, np.array(run.mass), start, v,
        step=step, steps=steps - steps % every, every=every,
    )  # fmt: skip
    track = tracks_of(run, where, shape, edges_at, f)
    found = distances(run, shape, track) | efforts(run, track, f)
    found |= obstacles(where, track, band_of(law))
    if isinstance(run.controller, Bounded):
        found |= proxies(track, f) | certificates(run, law, run.controller) | gravity(run, where, f)
        gains: Any = law.gains
        found |= rises(energies(run, gains.coupling, track, f))
    if isinstance(run.controller, ConnectivityStaticParams):
        found |= rises(static_energy(run, law, track, f))
    led, bounded = run.leader is not None, isinstance(run.controller, Bounded)
    return found, figures(run.names, where, track, f, led=led, bounded=bounded)
