"""Metrics of several vehicles: the five elements, and the error of a law's formation.

The five elements of `testbed.metrics.characterisation` are for any group. The error of a formation
depends on the kind of law:

    edges of a graph    largest difference of an edge of the start from its desired length; edges
                        to the leader count
    a curve             largest distance of a vehicle from the phase's curve; judged in the last
                        END_S of each phase, and the slowest phase counts
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from controllers.bifurcating_design import distance_to
from controllers.catalogue import Controller
from controllers.graph import formation, formation_kind
from testbed.metrics.characterisation import characterise, extremes
from testbed.metrics.run_metrics import FormationMetrics, Touch, Track
from testbed.metrics.touching import smallest_gap

Array = NDArray[np.float64]

EDGE_M = 0.08  # an edge is settled when its error stays below this [m]
CURVE_M = 0.10  # a vehicle is on a curve when it stays within this of it [m]
END_S = 5.0  # the end of a phase, or of a run, that counts [s]
STRIDE = 10  # every tenth sample of the track is enough for the error of a shape


class FormationContext(Struct, frozen=True):
    """The vehicles of the formation, in the order of the track."""

    names: Sequence[str]
    radius: Array  # (n,) [m]
    leader: Callable[[float], Array]  # position of the goal at a time, shape (2,) [m]


def has_formation(controller: object) -> bool:
    """Whether the law is for a formation, without separate goals of the vehicles."""
    return formation_kind(controller) is not None


def settled_after(t: Array, off: NDArray[Any]) -> float | None:
    """First time after which no sample is `off`; None if the last one is [s]."""
    late = np.flatnonzero(off)
    if len(late) == 0:
        return float(t[0])
    return float(t[late[-1] + 1]) if late[-1] + 1 < len(t) else None


class ShapeError(Struct, frozen=True):
    """Error of the formation."""

    error_m: float
    settled_s: float | None
    longest_edge_m: float | None = None
    lost_edges: int | None = None


def edges(controller: Any, context: FormationContext, t: Array, p: Array) -> ShapeError:
    """Error of a graph's edges; `p` of shape (m, n, 2)."""
    led = formation_kind(controller) == "led graph"
    shape = formation(controller.formation, list(context.names), led)
    if led:
        p = np.concatenate([p, np.array([context.leader(s) for s in t.tolist()])[:, None]], axis=1)
    off, longest, lost = np.zeros(len(t)), 0.0, 0
    metres = 1.0 / controller.scale.length  # of the law's unit
    for i, j in np.argwhere(np.triu(shape.first) > 0.0):
        gap = np.linalg.norm(p[:, i] - p[:, j], axis=1)
        off = np.maximum(off, np.abs(gap - metres * shape.desired[i, j]))
        longest = max(longest, float(gap.max()))
        lost += bool(gap.max() >= metres * shape.range)
    error = float(off[t >= t[-1] - END_S].max())
    return ShapeError(error, settled_after(t, off > EDGE_M), longest, lost)


def curves(controller: Any, t: Array, p: Array) -> ShapeError | None:
    """Error to the curves of phases that have one; `p` of shape (m, n, 2)."""
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
        after = settled_after(at, off > CURVE_M)
        times.append(None if after is None else after - phase.at)
    if not errors:
        return None
    known = [time for time in times if time is not None]
    return ShapeError(max(errors), max(known) if len(known) == len(times) else None)


def formation_metrics(
    controller: Controller, context: FormationContext, track: Track, touches: Sequence[Touch] = ()
) -> FormationMetrics | None:
    """Judge a flight of two or more vehicles; null for fewer, or without a track.

    Args:
        controller: the law.
        context: the vehicles.
        track: their true states; every sample counts for the distances.
        touches: contacts, which may be between two samples.
    """
    if len(context.names) < 2 or len(track.t) == 0:
        return None
    looked = np.append(np.arange(0, len(track.t) - 1, STRIDE), len(track.t) - 1)
    t, states = track.t[looked], track.states[looked]
    p = states[:, :, :2]
    end = characterise(p[-1], states[-1, :, 3:5], context.radius)
    closest, widest = extremes(track.states[:, :, :2], context.radius)
    shape: ShapeError | None = None
    kind = formation_kind(controller)
    if kind == "curves":
        shape = curves(controller, t, p)
    elif kind is not None:
        shape = edges(controller, context, t, p)
    return FormationMetrics(
        end,
        smallest_gap(closest, touches, context.names),
        widest,
        shape.error_m if shape else None,
        shape.settled_s if shape else None,
        shape.longest_edge_m if shape else None,
        shape.lost_edges if shape else None,
    )
