"""Least squares over windows with free initial states, robust against single bad windows.

Gauss-Newton. The initial states are eliminated window by window, so the normal equations have only
the vehicle's numbers. A window with large errors (a bump, a hand) counts less (Huber).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.identification.linearised import Pieces, linearised, normal
from testbed.identification.model import VehicleModel
from testbed.identification.windows import Windows, first_guess, pushed

Array = NDArray[np.float64]
HUBER = 1.5
SCALES = np.array([1e-3, 1e-3, 3e-3])  # first weights: m, m, rad
ITERATIONS = 12
PLACE = 0.5  # [m] side of the squares within which a rough table pushes alike
FEWEST_PLACES = 4


class Estimate(NamedTuple):
    """Fitted parameters, their standard deviations and the residuals."""

    p: Array  # all parameters
    free: NDArray[np.int64]  # those that were fitted
    sigma: Array  # standard deviation of each parameter; the prior's where it was not fitted
    covariance: Array  # of the free ones
    pieces: Pieces  # at the solution
    weights: Array  # of the windows, 0 to 1
    noise: Array  # (3,) of a pose after elimination [m, m, rad]


def linearise(
    model: VehicleModel, p: Array, free: NDArray[np.int64], logs: Sequence[Windows],
    states: Sequence[Array], scales: Array, ways: Sequence[Array] | None = None,
) -> Pieces:  # fmt: skip
    """All windows, linearised by the free parameters and a map, see `linearised`."""
    tried = [p]
    for k in free:
        nudged = p.copy()
        nudged[k] += model.step[k]
        tried.append(nudged)
    flights = [[pushed(model, one, windows) for one in tried] for windows in logs]
    return linearised(flights, model.step[free], logs, states, scales, ways)


def huber(pieces: Pieces) -> Array:
    """Weight of each window by its mean square error."""
    size = np.sqrt(pieces.square)
    limit = HUBER * max(float(np.median(size)), 1e-12)
    return np.minimum(1.0, limit / np.maximum(size, 1e-12))


def noise_of(pieces: Pieces, scales: Array) -> Array:
    """Robust size of the errors of position and heading."""
    position, heading = (np.median(np.abs(part)) for part in np.split(pieces.error, [2], axis=1))
    spread = np.array([position, position, heading]) / 0.6745
    return np.maximum(scales * spread, [1e-6, 1e-6, 1e-6])


def fit(
    model: VehicleModel,
    logs: Sequence[Windows],
    groups: Sequence[str],
    start: Array | None = None,
) -> Estimate:
    """Fit the parameters of some groups; the others keep the value of `start`, or the prior's."""
    free = model.of_groups(groups)
    p = model.prior.copy() if start is None else start.copy()
    prior = np.diag(1.0 / model.sigma[free] ** 2)
    states = [first_guess(w, np.isfinite(w.marks)) for w in logs]
    scales = SCALES
    for turn in range(ITERATIONS):
        pieces = linearise(model, p, free, logs, states, scales)
        weights = huber(pieces)
        level = float(np.average(pieces.square, weights=weights))
        matrix, side = normal(pieces, weights / level)
        pull = prior @ (model.prior - p)[free]
        step = np.linalg.solve(matrix + prior, side + pull)
        step *= min(1.0, 1.0 / float(np.max(np.abs(step) / model.sigma[free])))
        moved = np.clip(p[free] + step, model.least[free], None)
        step = moved - p[free]
        p[free] = moved
        follow(states, pieces, step)
        scales = noise_of(pieces, scales)
        if turn > 1 and np.all(np.abs(step) < 2e-3 * model.sigma[free]):
            break
    pieces = linearise(model, p, free, logs, states, scales)
    weights = huber(pieces)
    covariance = _covariance(pieces, weights, prior)
    slope = np.isin(free, model.of_groups(["slope"]))
    covariance = _over_places(covariance, pieces, weights, logs, prior, slope)
    sigma = model.sigma.copy()
    sigma[free] = np.sqrt(np.diag(covariance))
    return Estimate(p, free, sigma, covariance, pieces, weights, scales)


def follow(states: Sequence[Array], pieces: Pieces, step: Array) -> None:
    """Move the initial states with a step of the numbers.

    Raises:
        LinAlgError: the step is not finite.
    """
    if not np.isfinite(step).all():
        raise np.linalg.LinAlgError("no finite solution")
    change = pieces.start - pieces.follows @ step
    for number, own in enumerate(states):
        own += change[pieces.log == number]


def _covariance(pieces: Pieces, weights: Array, prior: Array) -> Array:
    """Covariance that holds also where errors within a window go together.

    Each window is one observation ("sandwich"); never less than independent errors would give.
    """
    level = float(np.average(pieces.square, weights=weights))
    matrix, _ = normal(pieces, weights / level)
    inverse = np.linalg.inv(matrix + prior)
    pulls = weights[:, None] / level * pieces.side
    count, size = pulls.shape
    spread = pulls.T @ pulls * count / max(1, count - size)
    clustered = inverse @ (spread + prior) @ inverse
    grow = np.sqrt(np.maximum(1.0, np.diag(inverse) / np.diag(clustered)))
    return clustered * np.outer(grow, grow)


def _over_places(
    covariance: Array, pieces: Pieces, weights: Array, logs: Sequence[Windows],
    prior: Array, which: NDArray[np.bool_],
) -> Array:  # fmt: skip
    """The covariance, wider where the errors of one place go together.

    The slope of a rough table differs from place to place, so a place is one observation of it,
    however long the vehicle was there. `which` are the parameters that it concerns.
    """
    corners = np.concatenate([windows.seen[:, 0, :2] for windows in logs]) // PLACE
    _, place = np.unique(corners, axis=0, return_inverse=True)
    places = int(place.max()) + 1
    if places < FEWEST_PLACES:
        return covariance
    level = float(np.average(pieces.square, weights=weights))
    matrix, _ = normal(pieces, weights / level)
    pulls = np.zeros((places, len(which)))
    np.add.at(pulls, place.ravel(), weights[:, None] / level * pieces.side)
    moved = pulls @ np.linalg.inv(matrix + prior)
    variance = np.sum(moved**2, axis=0) * places / (places - 1)
    now = np.diag(covariance)
    grow = np.where(which, np.sqrt(np.maximum(1.0, variance / now)), 1.0)
    return covariance * np.outer(grow, grow)
