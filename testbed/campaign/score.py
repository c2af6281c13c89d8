"""Numbers for campaigns that a single run does not print.

goal_rms_m    true position against the goal: in the last 30 s, or in the second half of the run
              where that is shorter or the goal moves
shape_rms_m   a vehicle's distances to its partners of the formation against the wanted ones, in
              the second half of the run
clearance_m   smallest distance to an obstacle less its danger radius
"""

from collections.abc import Mapping
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from controllers.graph import formation_kind
from testbed.config import Experiment
from testbed.metrics.run_metrics import HOLD_S, Track, obstacle_distances
from testbed.report.goal_error import goal_at

Array = NDArray[np.float64]


def beside_metrics(
    experiment: Experiment, track: Track
) -> dict[str, dict[str, float | int | None]]:
    """The numbers above, by vehicle."""
    if len(track.t) == 0:
        return {}
    late = track.t >= 0.5 * experiment.duration_s
    end = track.t > track.t[-1] - HOLD_S
    wanted = wanted_distances(experiment)
    to_goal = formation_kind(experiment.controller) is None
    numbers: dict[str, dict[str, float | int | None]] = {}
    for k, (name, setup) in enumerate(experiment.vehicles.items()):
        gaps = [
            distance - experiment.obstacles[obstacle].radius
            for obstacle, distance in obstacle_distances(track, k, experiment.obstacles).items()
        ]
        window = late & end if setup.path is None else late
        off = track.states[window, k, :2] - goal_at(setup, track.t[window])
        numbers[name] = {
            "goal_rms_m": _rms(np.hypot(*off.T)) if to_goal else None,
            "shape_rms_m": _rms(shape_errors(experiment, track, late, name, wanted)),
            "clearance_m": min(gaps) if gaps else None,
        }
    return numbers


def wanted_distances(experiment: Experiment) -> dict[tuple[str, str], float]:
    """Desired distances of the formation's pairs [m]; empty without a formation."""
    formation = getattr(experiment.controller, "formation", None)
    distances: Mapping[str, float] = getattr(formation, "distances", {})
    reach = getattr(formation, "far", np.inf)
    return {
        (a, b): distances[f"{a}-{b}"]
        for a, b in permutations(experiment.vehicles, 2)
        if distances.get(f"{a}-{b}", np.inf) < reach
    }


def shape_errors(
    experiment: Experiment,
    track: Track,
    late: NDArray[np.bool_],
    name: str,
    wanted: Mapping[tuple[str, str], float],
) -> Array:
    """Errors of a vehicle's distances to its partners, at all times [m]."""
    names = list(experiment.vehicles)
    errors = [np.zeros(0)]
    for (a, b), distance in wanted.items():
        if name in (a, b):
            pair = track.states[late][:, [names.index(a), names.index(b)], :2]
            errors.append(np.hypot(*(pair[:, 0] - pair[:, 1]).T) - distance)
    return np.concatenate(errors)


def _rms(values: Array) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None
