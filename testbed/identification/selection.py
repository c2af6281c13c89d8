"""Which groups of parameters a log supports: cross-validation by time and by region.

Around the fit of all parameters the errors are linear, so leaving a part of the log out, and a
group at its prior, is one linear solve.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from testbed.identification.estimate import Estimate
from testbed.identification.linearised import normal
from testbed.identification.model import VehicleModel
from testbed.identification.windows import Windows

Array = NDArray[np.float64]
TIME_FOLDS = 6  # parts of the log by time; by region there are four
ALWAYS = ("thrust", "delay", "slope")  # no table is level
LEAST_GAIN = 0.0005  # of the error, relative
NEEDED = 1.0  # least growth of unseen parts' square error without a group; 1: it doubles
SURE = 2.0  # standard deviations


def folds(estimate: Estimate, logs: Sequence[Windows]) -> list[NDArray[np.int64]]:
    """Number of the part of each window: by time, and by place."""
    place = np.concatenate([windows.seen[:, 0, :2] for windows in logs])
    count = len(place)
    by_time = np.arange(count) * min(TIME_FOLDS, count) // count
    middle = np.median(place, axis=0)
    by_region = 2 * (place[:, 0] > middle[0]) + (place[:, 1] > middle[1])
    return [by_time, by_region]


def choose(
    model: VehicleModel, estimate: Estimate, logs: Sequence[Windows]
) -> tuple[list[str], dict[str, float]]:
    """The groups that predict unseen parts better, and the gain of each (relative).

    Args:
        model: the vehicle.
        estimate: of all groups.
        logs: its windows.
    """
    groups = list(dict.fromkeys(model.parameters[k].group for k in estimate.free))
    parts = folds(estimate, logs)
    chosen = [g for g in groups if g in ALWAYS]
    rest = [g for g in groups if g not in ALWAYS]
    gains: dict[str, float] = {}
    now = unseen(model, estimate, parts, chosen)
    while rest:
        tried = {g: unseen(model, estimate, parts, [*chosen, g]) for g in rest}
        best = min(rest, key=lambda g: float(tried[g].mean()))
        gain = now - tried[best]
        error = gain.std() / np.sqrt(len(gain))
        relative = float(gain.mean() / now.mean())
        if relative < LEAST_GAIN or gain.mean() < 0.5 * error:
            gains |= {g: float((now - tried[g]).mean() / now.mean()) for g in rest}
            break
        gains[best], now = relative, tried[best]
        chosen.append(best)
        rest.remove(best)
    return chosen, gains


def needed(group: str, model: VehicleModel, estimate: Estimate, logs: Sequence[Windows]) -> bool:
    """Whether unseen parts are predicted far worse without a group; `estimate` is of all groups."""
    parts = folds(estimate, logs)
    groups = list(dict.fromkeys(model.parameters[k].group for k in estimate.free))
    full = unseen(model, estimate, parts, groups)
    worse = unseen(model, estimate, parts, [g for g in groups if g != group]) - full
    error = worse.std() / np.sqrt(len(worse))
    return bool(worse.mean() > NEEDED * full.mean() and worse.mean() > SURE * error)


def unseen(
    model: VehicleModel,
    estimate: Estimate,
    parts: Sequence[NDArray[np.int64]],
    groups: Sequence[str],
) -> Array:
    """Weighted square error of each window when its part was not in the fit; both ways of parts."""
    free = estimate.free
    used = np.isin(free, model.of_groups(groups))
    prior = np.diag(1.0 / model.sigma[free][used] ** 2)
    back = np.where(used, 0.0, (model.prior - estimate.p)[free])  # groups at their prior
    pull = prior @ (model.prior - estimate.p)[free][used]
    pieces, weights = estimate.pieces, estimate.weights
    level = float(np.average(pieces.square, weights=weights))
    errors = np.zeros(len(weights))
    for part in parts:
        for fold in np.unique(part):
            out = part == fold
            if out.all():
                continue
            matrix, side = normal(pieces, np.where(out, 0.0, weights / level))
            side -= matrix @ back
            step = back.copy()
            step[used] = np.linalg.solve(matrix[np.ix_(used, used)] + prior, side[used] + pull)
            left = pieces.power[out] - 2.0 * pieces.side[out] @ step
            left += (pieces.matrix[out] @ step) @ step
            errors[out] += weights[out] * left / pieces.size[out] / len(parts)
    return errors
