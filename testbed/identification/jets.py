"""Hypotheses about single jets, tried before the fit: dead, weak, exchanged with another.

Each valve command gets a free wrench (force and torque), linear around a first fit. Then the wrench
is compared with that of its own jet, of no jet and of every other jet.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.identification.estimate import SCALES, follow, huber, noise_of
from testbed.identification.linearised import Pieces, linearised, normal
from testbed.identification.model import VehicleModel
from testbed.identification.prediction import Valves
from testbed.identification.windows import Windows, first_guess, pushed

Array = NDArray[np.float64]
DEAD = 0.35  # of the nominal thrust: at most this, with its interval
WEAK = 0.75
BETTER = 25.0  # of chi^2, by which an exchange must explain more
LEVER = 0.2  # [m] of a free torque
NUDGE = 0.05  # difference of a wrench, in units of `sizes`
INFLATED = 2.0  # errors within a window go together
BESIDE = ("delay", "hold", "slope", "drag", "spin_drag", "droop")  # fitted beside the wrenches


class JetFinding(NamedTuple):
    """Which jet a valve's commands open, and how strong it is."""

    jet: int  # index, 0 is jet 1
    state: str  # ok, dead, weak, exchanged, not excited
    share: float  # of the nominal thrust, relative to the other jets
    sigma: float
    other: int = -1  # the jet that it is exchanged with


def examine(model: VehicleModel, p: Array, logs: Sequence[Windows]) -> list[JetFinding]:
    """A finding for each jet, around a first fit `p`."""
    base = model.plant.effect[0] * model.thrust(p)
    jets = base.shape[1]
    strong = float(np.median(np.hypot(base[0], base[1])))
    sizes = np.array([strong, strong, strong * LEVER])
    pieces = _linearised(model, p, logs, base, sizes)
    pieces = _linearised(model, p, logs, base, sizes, noise_of(pieces, SCALES))
    weights = huber(pieces)
    level = float(np.average(pieces.square, weights=weights))
    matrix, side = normal(pieces, weights / level)
    known = np.concatenate([np.ones(3 * jets), model.sigma[model.of_groups(BESIDE)] ** -2])
    covariance = np.linalg.inv(matrix / INFLATED**2 + np.diag(known))
    change = (covariance @ (side / INFLATED**2))[: 3 * jets]
    wrench = base / sizes[:, None] + change.reshape(jets, 3).T
    nominal = base / sizes[:, None]
    blocks = [covariance[3 * j : 3 * j + 3, 3 * j : 3 * j + 3] for j in range(jets)]
    shares, sigmas = np.zeros(jets), np.zeros(jets)
    misfit = np.zeros((jets, jets))
    for j in range(jets):
        inverse = np.linalg.inv(blocks[j])
        power = nominal[:, j] @ inverse @ nominal[:, j]
        shares[j], sigmas[j] = (nominal[:, j] @ inverse @ wrench[:, j]) / power, power**-0.5
        for k in range(jets):
            gap = wrench[:, j] - nominal[:, k]
            misfit[j, k] = gap @ inverse @ gap
    common = float(np.median(shares))
    shares, sigmas = shares / common, sigmas / common
    found = []
    for j in range(jets):
        gain = [
            misfit[j, j] + misfit[k, k] - misfit[j, k] - misfit[k, j] if k != j else 0.0
            for k in range(jets)
        ]
        k = int(np.argmax(gain))
        right = misfit[j, k] + misfit[k, j] < 0.5 * (misfit[j, j] + misfit[k, k])
        low, high = shares[j] - 2.0 * sigmas[j], shares[j] + 2.0 * sigmas[j]
        if not _opened(logs, j) or sigmas[j] > 0.5:
            state = "not excited"
        elif gain[k] > BETTER and right and shares[j] < WEAK and shares[k] < WEAK:
            state = "exchanged"
        elif shares[j] < DEAD and high < WEAK:
            state = "dead"
        elif high < WEAK and low > 0.0:
            state = "weak"
        else:
            state = "ok"
        other = k if state == "exchanged" else -1
        found.append(JetFinding(j, state, float(shares[j]), float(sigmas[j]), other))
    return found


def _opened(logs: Sequence[Windows], jet: int) -> bool:
    return any(isinstance(w.log.inputs, Valves) and (w.log.inputs.jet == jet).any() for w in logs)


def _linearised(
    model: VehicleModel, p: Array, logs: Sequence[Windows], base: Array, sizes: Array,
    scales: Array = SCALES,
) -> Pieces:  # fmt: skip
    """Windows linearised by the wrench of each jet, in units of `sizes`."""
    beside = model.of_groups(BESIDE)
    flights = []
    for windows in logs:
        tried = [pushed(model, p, windows)]
        for j in range(base.shape[1]):
            for axis in range(3):
                effect = base.copy()
                effect[axis, j] += NUDGE * sizes[axis]
                tried.append(pushed(model, p, windows, effect))
        for own in beside:
            nudged = p.copy()
            nudged[own] += model.step[own]
            tried.append(pushed(model, nudged, windows))
        flights.append(tried)
    steps = np.concatenate([np.full(3 * base.shape[1], NUDGE), model.step[beside]])
    states = [first_guess(windows, np.isfinite(windows.marks)) for windows in logs]
    for _ in range(2):
        alone = linearised([own[:1] for own in flights], np.zeros(0), logs, states, scales)
        follow(states, alone, np.zeros(0))
    return linearised(flights, steps, logs, states, scales)
