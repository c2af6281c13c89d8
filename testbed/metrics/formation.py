"""What several vehicles were worth together: five elements, and the formation that a law is for.

The five elements of `testbed.metrics.characterisation` are for any group. How far off a formation is
depends on what the law calls one:

    edges of a graph    largest difference of an edge of the start from its desired length; one to
                        the leader counts
    a curve             largest distance of a vehicle from the phase's curve; judged in the last
                        END_S of each phase, and the slowest phase counts

Laws whose proof asks something of the start say here what this one does not have (`concerns`).
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from controllers import certificate as proof
from controllers.bifurcating import BifurcatingParams
from controllers.bifurcating_design import distance_to
from controllers.bounded_formation import BoundedFormationParams
from controllers.bounded_leader import BoundedLeaderParams
from controllers.bounded_leader_varying import BoundedLeaderVaryingParams
from controllers.catalogue import Controller
from controllers.collision_sliding import CollisionSlidingParams
from controllers.connectivity_dynamic import ConnectivityDynamicParams
from controllers.connectivity_static import ConnectivityStaticParams
from controllers.graph import formation
from controllers.proxy import coupling
from controllers.scale import Scale
from testbed.core.law import Discs
from testbed.core.table import Obstacle
from testbed.metrics.characterisation import Characterisation, characterise, extremes
from testbed.metrics.run_metrics import Track

Array = NDArray[np.float64]

EDGE_M = 0.08  # an edge is settled when it stays within this of its length [m]
CURVE_M = 0.10  # a vehicle is on a curve when it stays within this of it [m]
END_S = 5.0  # the end of a phase, or of a run, that counts [s]
STRIDE = 10  # of the track are enough for what changes slowly

Led = BoundedLeaderParams | BoundedLeaderVaryingParams
Bounded = BoundedFormationParams | Led
Edged = Bounded | ConnectivityStaticParams | ConnectivityDynamicParams | CollisionSlidingParams


class Concern(Struct, frozen=True):
    """Something that a law's proof asks for and this start does not have."""

    name: str
    text: str


class FormationMetrics(Struct, frozen=True):
    """The section `formation` of metrics.json; null where the law has nothing of the kind."""

    end: Characterisation  # the five elements at the end
    closest_m: float  # smallest gap between two surfaces, of the run
    widest_m: float  # largest distance from the mean position, of the run
    error_m: float | None = None  # largest in the last 5 s, of the run or of each phase
    settled_s: float | None = None  # after which it is small for good; of the slowest phase
    longest_edge_m: float | None = None  # of the start's edges, over the run
    lost_edges: int | None = None  # that were once longer than the range
    concerns: tuple[Concern, ...] = ()


class FormationContext(Struct, frozen=True):
    """Who flew: all in the order of the track."""

    names: Sequence[str]
    radius: Array  # (n,) [m]
    mass: Array  # (n,) [kg]
    max_force: float  # of the weakest [N]
    leader: Callable[[float], tuple[Array, Array]]  # where the goal is and how fast, at a time


def has_formation(controller: object) -> bool:
    """Whether the law is for a formation, and no vehicle has a goal of its own."""
    return isinstance(controller, BifurcatingParams | Edged)


def settled(t: Array, off: NDArray[Any]) -> float | None:
    """First time after which nothing is `off`; null if the end is [s]."""
    late = np.flatnonzero(off)
    if len(late) == 0:
        return float(t[0])
    return float(t[late[-1] + 1]) if late[-1] + 1 < len(t) else None


class Shape(Struct, frozen=True):
    """How far off the formation was."""

    error_m: float
    settled_s: float | None
    longest_edge_m: float | None = None
    lost_edges: int | None = None


def edges(controller: Edged, crew: FormationContext, t: Array, p: Array) -> Shape:
    """A graph's edges; `p` of shape (m, n, 2)."""
    led = isinstance(controller, Led)
    shape = formation(controller.formation, list(crew.names), led)
    if led:
        p = np.concatenate([p, np.array([crew.leader(s)[0] for s in t.tolist()])[:, None]], axis=1)
    off, longest, lost = np.zeros(len(t)), 0.0, 0
    metres = 1.0 / controller.scale.length  # of the law's unit
    for i, j in np.argwhere(np.triu(shape.first) > 0.0):
        gap = np.linalg.norm(p[:, i] - p[:, j], axis=1)
        off = np.maximum(off, np.abs(gap - metres * shape.desired[i, j]))
        longest = max(longest, float(gap.max()))
        lost += bool(gap.max() >= metres * shape.range)
    error = float(off[t >= t[-1] - END_S].max())
    return Shape(error, settled(t, off > EDGE_M), longest, lost)


def curves(controller: BifurcatingParams, t: Array, p: Array) -> Shape | None:
    """The curves of phases that name one; `p` of shape (m, n, 2)."""
    centre = np.zeros(2) if controller.centre is None else np.array(controller.centre)
    ends = [*(phase.at for phase in controller.phases[1:]), np.inf]
    errors: list[float] = []
    times: list[float | None] = []
    for phase, end in zip(controller.phases, ends, strict=True):
        inside = (t >= phase.at) & (t <= end)
        if phase.shape is None or not inside.any():
            continue
        at = t[inside]
        off = distance_to(phase.shape, p[inside] - centre).max(axis=1)
        errors.append(float(off[at >= at[-1] - END_S].max()))
        after = settled(at, off > CURVE_M)
        times.append(None if after is None else after - phase.at)
    if not errors:
        return None
    known = [time for time in times if time is not None]
    return Shape(max(errors), max(known) if len(known) == len(times) else None)


def concerns(
    controller: Bounded, crew: FormationContext, p: Array, obstacles: Mapping[str, Obstacle]
) -> list[Concern]:
    """What the certificate has against the start `p`, (n, 2); all at rest."""
    if controller.scale != Scale():
        return []  # it speaks of the paper's units
    c = coupling(
        controller.proxy, controller.formation, list(crew.names), led=isinstance(controller, Led)
    )
    at, speed = crew.leader(0.0) if isinstance(controller, Led) else (np.zeros(2), np.zeros(2))
    centres = np.array([rock.position for rock in obstacles.values()]).reshape(-1, 2)
    radii = np.array([rock.radius for rock in obstacles.values()])
    discs = Discs(centres, 0.0 * centres, radii)
    fleet = proof.starting(crew.mass, p, np.zeros_like(p), at, speed)
    found = proof.certificate(c, fleet, crew.max_force, discs)
    if isinstance(controller, BoundedLeaderVaryingParams):
        dt = 0.1
        speeds = np.array([crew.leader(s)[1] for s in np.arange(0.0, 600.0, dt)])
        accel = float(np.linalg.norm(np.diff(speeds, axis=0), axis=1).max() / dt)
        found += proof.sgn_certificate(
            c, controller.alpha, controller.beta, controller.layer, crew.mass, accel
        )
    return [Concern(one.name, one.text) for one in found]


def formation_metrics(
    controller: Controller, crew: FormationContext, track: Track, obstacles: Mapping[str, Obstacle]
) -> FormationMetrics | None:
    """Judge a flight of two or more vehicles; null for fewer, or without a track."""
    if len(crew.names) < 2 or len(track.t) == 0:
        return None
    looked = np.append(np.arange(0, len(track.t) - 1, STRIDE), len(track.t) - 1)
    t, states = track.t[looked], track.states[looked]
    p = states[:, :, :2]
    end = characterise(p[-1], states[-1, :, 3:5], crew.radius)
    closest, widest = extremes(np.concatenate([p[::STRIDE], p[-1:]]), crew.radius)
    shape: Shape | None = None
    said: list[Concern] = []
    if isinstance(controller, BifurcatingParams):
        shape = curves(controller, t, p)
    elif isinstance(controller, Edged):
        shape = edges(controller, crew, t, p)
    if isinstance(controller, Bounded):
        said = concerns(controller, crew, p[0], obstacles)
    return FormationMetrics(
        end,
        closest,
        widest,
        shape.error_m if shape else None,
        shape.settled_s if shape else None,
        shape.longest_edge_m if shape else None,
        shape.lost_edges if shape else None,
        tuple(said),
    )
