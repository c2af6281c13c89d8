"""Whether a log is of another vehicle than the file's: by its thrust, its inertia and its levers.

A supply that is not known scales all thrusts, and droop bends them, so a common factor tells little
and only its extremes are judged. Levers do not depend on the supply: where the mapping names the
lab's other vehicles, the log is fitted with each of their files, and the one that needs the smaller
departures from its file is the likelier.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from testbed.core.vehicle import Vehicle
from testbed.identification.estimate import Estimate, fit
from testbed.identification.model import Array, VehicleModel
from testbed.identification.motion_log import MotionLog
from testbed.identification.suspicion import Suspicion, start_of
from testbed.identification.windows import Windows

NAME = "other-vehicle"
TOO_STRONG = 0.08  # of common thrust over the file's, beyond its tolerance
FAR_TOO_STRONG = 1.5  # factor of a single jet's thrust, droop apart
TOO_WEAK = 0.2  # under the file's, beyond its tolerance, droop apart
RATHER_WEAK = 0.08  # the same, for a warning: a regulator may be set so low
TURNING = 1.5  # factor of inertia
APART = 1.25  # factor of thrust between logs of one calibration
SURE = 2.0  # standard deviations
CERTAIN = 3.0  # of many comparisons
GEOMETRY = ("thrust", "delay", "slope", "droop", "hold", "inertia", "com", "jets")
MARGIN = 8.0  # of chi^2, by which another file must explain a log better
ENOUGH = 5  # windows, to compare files
FEWEST = 3  # windows, to compare a log with the others


def by_thrust(
    model: VehicleModel, estimate: Estimate, windows: Sequence[Windows]
) -> Iterator[Suspicion]:
    """Thrust over mass beyond the file's; `estimate` is of all groups."""
    start = model.prior.copy()  # dead and weak jets are in it
    start[:1], start[model.index("delay")] = estimate.p[:1], estimate.p[model.index("delay")]
    bare = fit(model, windows, ["thrust", "delay", "inertia", "slope"], start)
    scale, sigma = float(np.median(model.thrust(bare.p))), float(bare.sigma[0])
    own = float(np.median(model.thrust(estimate.p)))
    reach = SURE * own * float(estimate.sigma[0] / estimate.p[0])
    spread = model.vehicle.tolerance.thrust
    if scale - sigma > 1.0 + TOO_STRONG + spread or own - reach > FAR_TOO_STRONG:
        text = f"thrust over mass is {scale:.2f} times the file's ({own:.2f} without droop)"
        yield Suspicion(NAME, text + ": lighter, or another supply")
    weak = max(own + reach, scale + SURE * sigma) < 1.0 - TOO_WEAK - spread
    mean, reach = _mean_thrust(model, estimate)
    if weak or max(mean + SURE * reach, scale) < 1.0 - RATHER_WEAK - spread:
        text = f"thrust over mass is {mean:.2f} times the file's: heavier, or little supply"
        yield Suspicion(NAME, text, refuses=weak)
    k = model.index("inertia")
    value, reach = float(estimate.p[k]), SURE * float(estimate.sigma[k])
    if value - reach > TURNING or value + reach < 1.0 / TURNING:
        text = f"it turns as with {value:.2f} times the file's inertia (+- {reach:.2f})"
        yield Suspicion(NAME, text)


def _mean_thrust(model: VehicleModel, estimate: Estimate) -> tuple[float, float]:
    """Thrust of all jets together over the file's, and its standard deviation.

    Far better known than that of a jet: what one of them gives more, another gives less.
    """
    jets = len(model.vehicle.jets)
    slope = np.zeros(len(model.prior))
    slope[0], slope[1 : 1 + jets] = np.mean(estimate.p[1 : 1 + jets]), estimate.p[0] / jets
    slope = slope[estimate.free]
    mean = float(np.mean(model.thrust(estimate.p)))
    return mean, float(np.sqrt(slope @ estimate.covariance @ slope))


def between_logs(
    model: VehicleModel, estimate: Estimate, windows: Sequence[Windows]
) -> Iterator[Suspicion]:
    """Logs whose thrust over mass is not that of the others."""
    long = [one for one in windows if len(one.rows) >= FEWEST]
    if len(long) < 2:
        return
    found = [fit(model, [one], ["thrust", "delay"], estimate.p) for one in long]
    scale = np.array([one.p[0] for one in found]) / estimate.p[0]
    sigma = np.array([one.sigma[0] for one in found]) / estimate.p[0]
    for k, one in enumerate(long):
        rest = float(np.median(np.delete(scale, k)))
        low, high = scale[k] - CERTAIN * sigma[k], scale[k] + CERTAIN * sigma[k]
        if low > APART * rest or high < rest / APART:
            text = f"{one.log.where}: thrust over mass is {scale[k] / rest:.2f} times that of the"
            yield Suspicion(NAME, text + " other logs")


def by_levers(
    windows: Sequence[Windows], vehicle: Vehicle, others: Mapping[str, Vehicle]
) -> Iterator[Suspicion]:
    """Other vehicles of the lab whose files explain the logs with smaller departures."""
    rivals = {name: one for name, one in others.items() if _levers(one) != _levers(vehicle)}
    if not rivals:
        return
    ambiguous = set(rivals)
    for part in _parts(windows):
        own = departure(*part, vehicle)
        for name, rival in rivals.items():
            gain = own - departure(*part, rival)
            if abs(gain) > MARGIN:
                ambiguous.discard(name)
            if gain > MARGIN:
                where = ", ".join(log.where for log in part[0])
                text = f"{where}: the levers of {name} explain it better"
                yield Suspicion(NAME, f"{text} (chi^2 smaller by {gain:.0f})")
                break
    if ambiguous:
        text = f"too little flight to tell this vehicle from {', '.join(sorted(ambiguous))}"
        yield Suspicion("vehicle-ambiguous", text + ": is --vehicle right?", refuses=False)


Part = tuple[list[MotionLog], list[Windows]]


def _parts(windows: Sequence[Windows]) -> list[Part]:
    """Each log that is long enough to tell, and the short ones together."""
    long: list[Part] = []
    short: Part = ([], [])
    for one in windows:
        if len(one.rows) >= ENOUGH:
            long.append(([one.log], [one]))
        else:
            short[0].append(one.log)
            short[1].append(one)
    return [part for part in (*long, short) if sum(len(w.rows) for w in part[1]) >= ENOUGH]


def departure(logs: Sequence[MotionLog], windows: Sequence[Windows], vehicle: Vehicle) -> float:
    """How far the numbers of a vehicle must go from its file to explain the logs (chi^2)."""
    model = VehicleModel(vehicle, valves=True)
    first = fit(model, windows, ["thrust", "delay", "inertia"], start_of(model, logs, vehicle))
    found = fit(model, windows, GEOMETRY, first.p)
    gone: Array = ((found.p - model.prior) / model.sigma)[found.free]
    return float(gone @ gone)


def _levers(vehicle: Vehicle) -> list[tuple[float, ...]]:
    return [(*jet.position, *jet.push) for jet in vehicle.jets]
