"""Least squares over windows with free initial states, robust against single bad windows.

Gauss-Newton. The initial states are eliminated window by window, so the normal equations have only
the vehicle's numbers. A window with large errors (a bump, a hand) counts less (Huber).
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.identification.model import VehicleModel
from testbed.identification.windows import Windows, first_guess, fly, fly_with_slopes

Array = NDArray[np.float64]
HUBER = 1.5
SCALES = np.array([1e-3, 1e-3, 3e-3])  # first weights: m, m, rad
ITERATIONS = 12
PLACE = 0.5  # [m] side of the squares within which a rough table pushes alike
FEWEST_PLACES = 4


class Piece(NamedTuple):
    """One window, linearised, without its initial state."""

    log: int
    window: int
    error: Array  # (3 n,) measured minus flown, in units of the noise
    slope: Array  # (3 n, parameters) of the flown poses


class Estimate(NamedTuple):
    """Fitted parameters, their standard deviations and the residuals."""

    p: Array  # all parameters
    free: NDArray[np.int64]  # those that were fitted
    sigma: Array  # standard deviation of each parameter; the prior's where it was not fitted
    covariance: Array  # of the free ones
    pieces: list[Piece]  # at the solution
    weights: Array  # of the pieces, 0 to 1
    noise: Array  # (3,) of a pose after elimination [m, m, rad]


def linearise(
    model: VehicleModel, p: Array, free: NDArray[np.int64], logs: Sequence[Windows],
    states: list[Array], scales: Array,
) -> tuple[list[Piece], list[tuple[Array, Array, Array]]]:  # fmt: skip
    """Pieces of all windows, and what `corrected` needs of each."""
    found, rest = [], []
    for number, windows in enumerate(logs):
        flown, by_state = fly_with_slopes(model, p, windows, states[number])
        by_free = np.zeros((*flown.shape, len(free)))
        for k, f in enumerate(free):
            nudged = p.copy()
            nudged[f] += model.step[f]
            by_free[..., k] = (fly(model, nudged, windows, states[number]) - flown) / model.step[f]
        for w, use in enumerate(np.isfinite(windows.marks)):
            error = ((windows.seen[w, use] - flown[w, use]) / scales).ravel()
            by_x = (by_state[w, use] / scales[:, None]).reshape(-1, 6)
            by_p = (by_free[w, use] / scales[:, None]).reshape(-1, len(free))
            q, _ = np.linalg.qr(by_x)
            found.append(Piece(number, w, error - q @ (q.T @ error), by_p - q @ (q.T @ by_p)))
            rest.append((error, by_x, by_p))
    return found, rest


def normal(pieces: Sequence[Piece], weights: Array) -> tuple[Array, Array]:
    """Normal equations of some pieces: matrix and right-hand side."""
    size = pieces[0].slope.shape[1]
    matrix, side = np.zeros((size, size)), np.zeros(size)
    for weight, piece in zip(weights, pieces, strict=True):
        matrix += weight * piece.slope.T @ piece.slope
        side += weight * piece.slope.T @ piece.error
    return matrix, side


def huber(pieces: Sequence[Piece]) -> Array:
    """Weight of each piece by its mean square error."""
    size = np.array([np.sqrt(np.mean(piece.error**2)) for piece in pieces])
    limit = HUBER * max(float(np.median(size)), 1e-12)
    return np.minimum(1.0, limit / np.maximum(size, 1e-12))


def noise_of(pieces: Sequence[Piece], scales: Array) -> Array:
    """Robust size of the errors of position and heading."""
    error = np.concatenate([piece.error.reshape(-1, 3) for piece in pieces])
    position, heading = np.median(np.abs(error[:, :2])), np.median(np.abs(error[:, 2]))
    spread = np.array([position, position, heading]) / 0.6745
    return np.maximum(scales * spread, [1e-6, 1e-6, 1e-6])


def fit(
    model: VehicleModel,
    logs: Sequence[Windows],
    groups: Sequence[str],
    start: Array | None = None,
    progress: Callable[[int, Array], None] | None = None,
) -> Estimate:
    """Fit the parameters of some groups; the others keep the value of `start`, or the prior's."""
    free = model.of_groups(groups)
    p = model.prior.copy() if start is None else start.copy()
    prior = np.diag(1.0 / model.sigma[free] ** 2)
    states = [first_guess(w, np.isfinite(w.marks)) for w in logs]
    scales = SCALES
    for turn in range(ITERATIONS):
        pieces, rest = linearise(model, p, free, logs, states, scales)
        weights = huber(pieces)
        level = float(np.average([np.mean(q.error**2) for q in pieces], weights=weights))
        matrix, side = normal(pieces, weights / level)
        pull = prior @ (model.prior - p)[free]
        step = np.linalg.solve(matrix + prior, side + pull)
        step *= min(1.0, 1.0 / float(np.max(np.abs(step) / model.sigma[free])))
        moved = np.clip(p[free] + step, model.least[free], None)
        step = moved - p[free]
        p[free] = moved
        for piece, (error, by_x, by_p) in zip(pieces, rest, strict=True):
            states[piece.log][piece.window] += np.linalg.lstsq(
                by_x, error - by_p @ step, rcond=None
            )[0]
        if progress:
            progress(turn, p)
        scales = noise_of(pieces, scales)
        if turn > 1 and np.all(np.abs(step) < 2e-3 * model.sigma[free]):
            break
    pieces, _ = linearise(model, p, free, logs, states, scales)
    weights = huber(pieces)
    covariance = _covariance(pieces, weights, prior)
    slope = np.isin(free, model.of_groups(["slope"]))
    covariance = _over_places(covariance, pieces, weights, logs, prior, slope)
    sigma = model.sigma.copy()
    sigma[free] = np.sqrt(np.diag(covariance))
    return Estimate(p, free, sigma, covariance, pieces, weights, scales)


def _covariance(pieces: Sequence[Piece], weights: Array, prior: Array) -> Array:
    """Covariance that holds also where errors within a window go together.

    Each window is one observation ("sandwich"); never less than independent errors would give.
    """
    level = float(np.average([np.mean(q.error**2) for q in pieces], weights=weights))
    matrix, _ = normal(pieces, weights / level)
    inverse = np.linalg.inv(matrix + prior)
    pulls = np.array([
        w / level * q.slope.T @ q.error for w, q in zip(weights, pieces, strict=True)
    ])  # fmt: skip
    count, size = pulls.shape
    spread = pulls.T @ pulls * count / max(1, count - size)
    clustered = inverse @ (spread + prior) @ inverse
    grow = np.sqrt(np.maximum(1.0, np.diag(inverse) / np.diag(clustered)))
    return clustered * np.outer(grow, grow)


def _over_places(
    covariance: Array, pieces: Sequence[Piece], weights: Array, logs: Sequence[Windows],
    prior: Array, which: NDArray[np.bool_],
) -> Array:  # fmt: skip
    """The covariance, wider where the errors of one place go together.

    The slope of a rough table differs from place to place, so a place is one observation of it,
    however long the vehicle was there. `which` are the parameters that it concerns.
    """
    corners = [logs[q.log].seen[q.window, 0, :2] // PLACE for q in pieces]
    _, place = np.unique(np.array(corners), axis=0, return_inverse=True)
    places = int(place.max()) + 1
    if places < FEWEST_PLACES:
        return covariance
    level = float(np.average([np.mean(q.error**2) for q in pieces], weights=weights))
    matrix, _ = normal(pieces, weights / level)
    pulls = np.zeros((places, len(which)))
    for k, weight, piece in zip(place.ravel(), weights, pieces, strict=True):
        pulls[k] += weight / level * piece.slope.T @ piece.error
    moved = pulls @ np.linalg.inv(matrix + prior)
    variance = np.sum(moved**2, axis=0) * places / (places - 1)
    now = np.diag(covariance)
    grow = np.where(which, np.sqrt(np.maximum(1.0, variance / now)), 1.0)
    return covariance * np.outer(grow, grow)
