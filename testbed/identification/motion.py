"""`testbed calibrate motion`: from logs of free flight to a vehicle file."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from testbed.core.vehicle import Vehicle
from testbed.identification.columns import LogRefusedError
from testbed.identification.estimate import Estimate, fit
from testbed.identification.jets import JetFinding, examine
from testbed.identification.model import Parameter, VehicleModel
from testbed.identification.motion_log import MotionLog
from testbed.identification.moved_jets import by_moved_jets
from testbed.identification.other_vehicle import between_logs, by_levers, by_thrust
from testbed.identification.prediction import Valves
from testbed.identification.selection import choose, needed
from testbed.identification.suspicion import Suspicion, start_of, suspicions
from testbed.identification.windows import Windows, tiled

Array = NDArray[np.float64]
FEWEST_WINDOWS = 3
IDENTIFIABLE = (
    0.6  # standard deviation over that of the prior: above, the log does not tell the number
)
EARLY = 1e-3  # [s] before the command: a delay that is warned of
LATE = 0.08  # [s] later than in the file: the same
SURE = 1.96  # standard deviations of a 95 % interval
CLEARLY = 2.0  # times its tolerance: from this uncertainty of the logs on, the file knows better


class Calibration(NamedTuple):
    """Result of a calibration."""

    vehicle: Vehicle
    model: VehicleModel
    estimate: Estimate  # of the chosen groups
    wide: Estimate  # of all groups: intervals of what was not chosen
    chosen: list[str]
    gains: dict[str, float]
    jets: list[JetFinding]
    suspicions: list[Suspicion]
    logs: list[Windows]
    held: list[int]  # positions at the file's value, because the logs do not tell them


class RefusedError(LogRefusedError):
    """The logs are not what the mapping or the vehicle says; nothing was fitted."""

    def __init__(self, found: Sequence[Suspicion], where: str) -> None:
        super().__init__(
            where=where, expected="a log that the mapping and the vehicle describe",
            found="; ".join(f"{one.name}: {one.text}" for one in found),
            hint="correct the mapping or the vehicle file; --force fits in spite of this",
        )  # fmt: skip
        self.suspicions = list(found)


def calibrate_motion(
    logs: Sequence[MotionLog],
    vehicle: Vehicle,
    *,
    others: Mapping[str, Vehicle] | None = None,
    force: bool = False,
    progress: Callable[[str], None] = lambda text: None,
) -> Calibration:
    """Fit a vehicle to logs.

    Args:
        logs: of one vehicle, all with valves or all with wrenches.
        vehicle: prior values, with their tolerances.
        others: the lab's vehicles by name, with which this one may be exchanged.
        force: fit in spite of suspicions.
        progress: is called with the name of each step.

    Raises:
        RefusedError: a suspicion forbids a fit.
    """
    try:
        return _calibrated(logs, vehicle, others or {}, force, progress)
    except (np.linalg.LinAlgError, FloatingPointError) as error:
        raise LogRefusedError(
            where=", ".join(log.where for log in logs),
            expected="motion that tells the numbers of a vehicle", found=str(error),
            hint="too short, or hardly excited",
        ) from None  # fmt: skip


def _calibrated(
    logs: Sequence[MotionLog], vehicle: Vehicle, others: Mapping[str, Vehicle], force: bool,
    progress: Callable[[str], None],
) -> Calibration:  # fmt: skip
    """See `calibrate_motion`."""
    where = ", ".join(log.where for log in logs)
    progress("check the logs")
    model, doubts = checked(logs, vehicle)
    refusing = [one for one in doubts if one.refuses]
    if refusing and not force:
        raise RefusedError(refusing, where)
    windows = _windows(logs)
    if sum(len(w.rows) for w in windows) < FEWEST_WINDOWS:
        least = FEWEST_WINDOWS * logs[0].window_s
        raise LogRefusedError(
            where=where, expected=f"at least {least:g} s of undisturbed flight", found="less",
            hint="see [use] of the mapping",
        )  # fmt: skip
    model, jets, wide = _fitted_widely(model, logs, windows, progress)
    if model.valves:
        progress("compare with other vehicles")
        doubts += _of_another(model, jets, wide, windows, vehicle, others)
    progress("cross-validate")
    chosen, gains = choose(model, wide, windows)
    start = model.prior.copy()
    free = model.of_groups(chosen)
    start[free] = wide.p[free]
    progress("fit the chosen parameters")
    estimate = fit(model, windows, chosen, start)
    if model.valves:
        doubts += between_logs(model, estimate, windows)
    refusing = [one for one in doubts if one.refuses]
    if refusing and not force:
        raise RefusedError(refusing, where)
    progress("find what the logs do not tell")
    found = Calibration(vehicle, model, estimate, wide, chosen, gains, jets, doubts, windows, [])
    found = _settled(found, progress)
    found = found._replace(suspicions=[*found.suspicions, *_out_of_time(found)])
    return found._replace(vehicle=model.fitted(found.estimate.p))


def _out_of_time(c: Calibration) -> list[Suspicion]:
    """A delay that surely no vehicle can have, or that is surely much longer than the file's."""
    k = c.model.index("delay")
    late, file = float(c.estimate.p[k]), c.model.parameters[k].value
    low, high = interval(c, k)
    if late - file > LATE and low - file > 0.5 * LATE:
        text = (
            f"the vehicle moves {1e3 * late:.3g} ms after its commands, {1e3 * file:.3g} ms in the"
            " file: old poses (`latency_s` of [pose]), commands that wait, or the times of two"
            " clocks? Then it is no delay of the valves"
        )
        return [Suspicion("long-delay", text, refuses=False)]
    if late > -EARLY or high > 0.0:
        return []
    causes = ["a wrong `latency_s` of [pose]", "poses and commands with the times of two clocks"]
    if c.model.valves:
        causes.insert(0, "a wrong `period_s` or `phase_s` of [valves]")
    if c.model.vehicle.command_delay_s > 0.0:
        causes.append("a `command_delay_s` of the vehicle file that is too long")
    text = f"the vehicle moves {-1e3 * late:.3g} ms before its valves open, the file gets 0 ms:"
    return [Suspicion("negative-delay", f"{text} {', or '.join(causes)}", refuses=False)]


def _settled(c: Calibration, progress: Callable[[str], None]) -> Calibration:
    """The calibration with what the logs do not tell held at the file's value.

    With it held there, the groups are chosen again and the other numbers are fitted.
    """
    values = np.array([one.value for one in c.model.parameters])
    while True:
        c = c._replace(jets=_certain(c))
        held = _untold(c)
        if held == c.held:
            return c
        progress(f"fit again, with {len(held)} of the numbers held")
        own, start = c.model.holding(held), c.wide.p.copy()
        start[held] = values[held]
        groups = [g for g in own.groups if np.isin(own.of_groups([g]), c.wide.free).all()]
        rest = fit(own, c.logs, [g for g in groups if len(own.of_groups([g]))], start)
        chosen, gains = choose(own, rest, c.logs)
        start, free = c.model.prior.copy(), own.of_groups(chosen)
        start[held], start[free] = values[held], rest.p[free]
        estimate = fit(own, c.logs, chosen, start)
        c = c._replace(held=held, estimate=estimate, chosen=chosen, gains=gains)


def _untold(c: Calibration) -> list[int]:
    """Positions of the fitted numbers that are to keep the file's value.

    A jet whose thrust is not identifiable gets the file's times the common factor, unless single
    jets predict so much better that the logs do tell that they differ.
    """
    jets = len(c.model.vehicle.jets) if c.model.valves else 0
    held = {int(k) for k in c.estimate.free if not 0 < k <= jets and not identifiable(c, int(k))}
    alike = not jets or "jets" not in c.chosen or not needed("jets", c.model, c.wide, c.logs)
    for row in thrusts(c) if jets else []:
        if not row["identifiable"] and (alike or row["state"] == "not excited"):
            held.add(row["jet"])
    return sorted(held.union(c.held))


def _certain(c: Calibration) -> list[JetFinding]:
    """Findings without a dead or weak jet whose interval has the file's thrust in it."""
    if not c.model.valves:
        return c.jets
    doubtful = [row["jet"] - 1 for row in thrusts(c) if row["high_n"] >= row["file_n"]]
    return [
        one._replace(state="not excited")
        if one.state in ("dead", "weak") and one.jet in doubtful
        else one
        for one in c.jets
    ]


def _fitted_widely(
    model: VehicleModel, logs: Sequence[MotionLog], windows: Sequence[Windows],
    progress: Callable[[str], None],
) -> tuple[VehicleModel, list[JetFinding], Estimate]:  # fmt: skip
    """The model with exchanged jets set right, what is found of each jet, a fit of all groups."""
    first = start_of(model, logs, model.vehicle)
    progress("try dead, weak and exchanged jets")
    rough = fit(model, windows, ["thrust", "delay", "inertia"], first)
    jets: list[JetFinding] = []
    if model.valves:
        jets = examine(model, rough.p, windows)
        if exchanged := [one for one in jets if one.state == "exchanged"]:
            model = VehicleModel(_exchanged(model.vehicle, exchanged), valves=True)
            rough = fit(model, windows, ["thrust", "delay", "inertia"], first)
        _expect(model, jets)
    progress("fit all parameters")
    groups = model.groups
    if not model.valves:
        groups = [g for g in groups if g not in _unidentifiable_from_wrenches(logs)]
    wide = fit(model, windows, groups, _merged(model, rough))
    all_of_them = Calibration(model.vehicle, model, wide, wide, groups, {}, jets, [], [], [])
    certain = _certain(all_of_them)
    if certain == jets:
        return model, jets, wide
    for before, now in zip(jets, certain, strict=True):
        if now != before:
            model.prior[1 + now.jet] = model.parameters[1 + now.jet].value
    return model, certain, fit(model, windows, groups, _merged(model, rough))


def _of_another(
    model: VehicleModel, jets: Sequence[JetFinding], wide: Estimate, windows: Sequence[Windows],
    vehicle: Vehicle, others: Mapping[str, Vehicle],
) -> list[Suspicion]:  # fmt: skip
    """Whether logs with valve commands are of another vehicle."""
    found = [*by_thrust(model, wide, windows), *by_levers(windows, vehicle, others)]
    return [*found, *by_moved_jets(model, jets, wide, windows)]


def doubts_about(
    logs: Sequence[MotionLog], vehicle: Vehicle, others: Mapping[str, Vehicle],
    progress: Callable[[str], None] = lambda text: None,
) -> list[Suspicion]:  # fmt: skip
    """What is wrong with the logs, and whether they are of another vehicle; nothing is chosen."""
    progress("check the logs")
    model, doubts = checked(logs, vehicle)
    windows = _windows(logs)
    if doubts or not model.valves or sum(len(w.rows) for w in windows) < FEWEST_WINDOWS:
        return doubts
    try:
        model, jets, wide = _fitted_widely(model, logs, windows, progress)
        progress("compare with other vehicles")
        return _of_another(model, jets, wide, windows, vehicle, others)
    except (np.linalg.LinAlgError, FloatingPointError):
        return []  # hardly excited


def admitted(
    logs: Sequence[MotionLog], vehicle: Vehicle, others: Mapping[str, Vehicle],
    progress: Callable[[str], None], *, force: bool,
) -> list[Suspicion]:  # fmt: skip
    """Suspicions of `doubts_about`, for verbs that refuse what `calibrate_motion` refuses.

    Raises:
        RefusedError: a suspicion forbids a fit, and it is not forced.
    """
    doubts = doubts_about(logs, vehicle, others, progress)
    refusing = [one for one in doubts if one.refuses]
    if refusing and not force:
        raise RefusedError(refusing, ", ".join(log.where for log in logs))
    return doubts


def _windows(logs: Sequence[MotionLog]) -> list[Windows]:
    return [w for w in (tiled(log, log.window_s) for log in logs) if len(w.rows)]


def checked(logs: Sequence[MotionLog], vehicle: Vehicle) -> tuple[VehicleModel, list[Suspicion]]:
    """The model for these logs, and what is wrong with them."""
    valves = isinstance(logs[0].inputs, Valves)
    jets = max((int(i.jet.max(initial=-1)) for i in (log.inputs for log in logs)
                if isinstance(i, Valves)), default=-1)  # fmt: skip
    if jets >= len(vehicle.jets):
        raise LogRefusedError(
            where=logs[0].where, expected=f"{len(vehicle.jets)} valves, the vehicle's jets",
            found=f"valve {jets + 1}", hint="another vehicle?",
        )  # fmt: skip
    return VehicleModel(vehicle, valves=valves), list(suspicions(logs, vehicle))


def _unidentifiable_from_wrenches(logs: Sequence[MotionLog]) -> list[str]:
    """Groups that say nothing where the torque is not in the log."""
    silent = all(not np.any(log.inputs.wrench[:, 2]) for log in logs)  # type: ignore[union-attr]
    return ["inertia", "com", "spin_drag"] if silent else []


def _exchanged(vehicle: Vehicle, found: Sequence[JetFinding]) -> Vehicle:
    """The vehicle with exchanged jets at each other's place, with their own thrust."""
    jets = list(vehicle.jets)
    for one in found:
        jets[one.jet] = vehicle.jets[one.other]
    return structs.replace(vehicle, jets=jets)


def _expect(model: VehicleModel, jets: Sequence[JetFinding]) -> None:
    """Priors of dead and weak jets."""
    for one in jets:
        if one.state in ("dead", "weak"):
            model.prior[1 + one.jet] = max(model.least[1 + one.jet], one.share)


def _merged(model: VehicleModel, rough: Estimate) -> Array:
    """The first fit, with the priors of the jets."""
    p = model.prior.copy()
    p[rough.free] = rough.p[rough.free]
    return p


def identifiable(calibration: Calibration, k: int) -> bool:
    """Whether the logs tell the number `k` of the model, better than the vehicle file does."""
    c = calibration
    told = k in c.wide.free and k not in c.held and not _file_knows_better(c, k)
    always = c.model.parameters[k].group in ("slope", "droop")  # a fit needs these
    far = c.wide.sigma[k] if always else reach(c, k)
    return bool(told and far < IDENTIFIABLE * c.model.sigma[k])


def _file_knows_better(c: Calibration, k: int) -> bool:
    """Whether the file states a number far more closely than the logs, and they allow its value."""
    tolerance, number, far = c.vehicle.tolerance, c.model.parameters[k], reach(c, k)
    push = math.hypot(tolerance.mass, tolerance.thrust)
    stated = {
        "thrust": push, "mass": push, "inertia": tolerance.inertia, "com_x": tolerance.com,
        "com_y": tolerance.com,
    }.get(number.name, math.inf)  # fmt: skip
    return far > CLEARLY * stated and abs(c.wide.p[k] - number.value) < SURE * far


def reach(calibration: Calibration, k: int) -> float:
    """Standard deviation of the number `k`: that of the fit of all groups, or of the chosen ones.

    It is widened by what the choice of groups changed.
    """
    c = calibration
    sigma = max(c.wide.sigma[k], c.estimate.sigma[k] if k in c.estimate.free else 0.0)
    return float(np.hypot(sigma, c.estimate.p[k] - c.wide.p[k]))


def interval(calibration: Calibration, k: int) -> tuple[float, float]:
    """95 % interval of the number `k`, see `reach`."""
    c = calibration
    own: Parameter = c.model.parameters[k]
    value, far = c.estimate.p[k], SURE * reach(c, k)
    return float(max(own.least, value - far)), float(value + far)


def thrusts(calibration: Calibration) -> list[dict[str, Any]]:
    """Thrust of each jet with its interval [N]."""
    c, jets = calibration, len(calibration.model.vehicle.jets)
    p, free = c.wide.p, list(c.wide.free)
    own = float(np.hypot(c.model.sigma[0], c.model.sigma[1]))
    rows = []
    for j in range(jets):
        slope = np.zeros(len(free))
        slope[free.index(0)] = p[1 + j]
        if 1 + j in free:
            slope[free.index(1 + j)] = p[0]
        sigma = float(np.sqrt(slope @ c.wide.covariance @ slope))
        sigma = float(np.hypot(sigma, c.model.thrust(p)[j] - c.model.thrust(c.estimate.p)[j]))
        nominal = c.model.vehicle.jets[j].thrust
        value = float(nominal * c.model.thrust(c.estimate.p)[j])
        far = SURE * sigma * nominal
        found = c.jets[j]
        vague = sigma > CLEARLY * c.vehicle.tolerance.thrust and abs(value - nominal) < far
        rows.append({
            "jet": j + 1, "thrust_n": value, "low_n": max(0.0, value - far),
            "high_n": value + far, "file_n": nominal, "state": found.state,
            "exchanged_with": found.other + 1 if found.other >= 0 else None,
            "identifiable": found.state in ("dead", "weak")
            or bool(found.state != "not excited" and sigma < IDENTIFIABLE * own and not vague),
            "fitted": 1 + j in c.estimate.free, "kept": bool(value == nominal),
        })  # fmt: skip
    return rows
