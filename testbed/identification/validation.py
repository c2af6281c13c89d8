"""`testbed validate`: how far ahead the twin predicts a log, beside another vehicle file."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.table import Table
from testbed.core.vehicle import Vehicle
from testbed.identification.model import VehicleModel
from testbed.identification.motion_log import MotionLog
from testbed.identification.prediction import Valves
from testbed.identification.windows import ahead_of, sliding, stretches

Array = NDArray[np.float64]
HORIZONS = (1.0, 3.0, 5.0)  # [s]
BEFORE = 1.0  # [s] of poses that give the state at the start; nothing later is used
EVERY = 0.5  # [s] between two predictions
WEIGHT = np.array([1e3, 1e3, 3e2])  # 1 mm and 3.3 mrad count alike in the start state


class HorizonErrors(NamedTuple):
    """Errors at one horizon, measured minus predicted."""

    horizon: float  # [s]
    t: Array  # (k,) time of each prediction [s]
    at: Array  # (k, 2) measured position at the start [m]
    error: Array  # (k, 3) [m, m, rad]
    on: Array  # (k, jets) open time of each jet on the way [s]
    heading: Array  # (k,) at the start [rad]

    def figures(self) -> dict[str, Any]:
        """RMS and median, or nulls without a prediction."""
        if not len(self.t):
            return {"position_rms_m": None, "position_median_m": None, "heading_rms_deg": None,
                    "count": 0}  # fmt: skip
        size = np.hypot(self.error[:, 0], self.error[:, 1])
        return {
            "position_rms_m": float(np.sqrt(np.mean(size**2))),
            "position_median_m": float(np.median(size)),
            "heading_rms_deg": float(np.degrees(np.sqrt(np.mean(self.error[:, 2] ** 2)))),
            "count": len(size),
        }


def errors_ahead(
    logs: Sequence[MotionLog], vehicle: Vehicle, horizon: float, table: Table | None = None
) -> HorizonErrors:
    """Errors of a vehicle at one horizon, of all logs together."""
    parts = []
    for log in logs:
        windows = sliding(log, BEFORE, horizon, EVERY)
        if not windows.rows:
            continue
        model = VehicleModel(vehicle, valves=isinstance(log.inputs, Valves), table=table)
        error = ahead_of(model, model.prior, windows, BEFORE, WEIGHT)
        last = np.array([len(rows) - 1 for rows in windows.rows])
        begin = windows.begin + BEFORE
        first = [
            int(np.searchsorted(log.t[rows], b))
            for rows, b in zip(windows.rows, begin, strict=True)
        ]
        start = np.array(
            [log.pose[r[min(k, len(r) - 1)]] for r, k in zip(windows.rows, first, strict=True)]
        )
        parts.append((begin, start, error[np.arange(len(last)), last],
                      _open_time(log, begin, begin + horizon, len(vehicle.jets))))  # fmt: skip
    if not parts:
        none = np.zeros(0)
        return HorizonErrors(horizon, none, np.zeros((0, 2)), np.zeros((0, 3)),
                     np.zeros((0, len(vehicle.jets))), none)  # fmt: skip
    begin, start, error, on = (np.concatenate(column) for column in zip(*parts, strict=True))
    return HorizonErrors(horizon, begin, start[:, :2], error, on, start[:, 2])


def _open_time(log: MotionLog, begin: Array, end: Array, jets: int) -> Array:
    on = np.zeros((len(begin), jets))
    if isinstance(log.inputs, Valves):
        for j in range(jets):
            mine = log.inputs.jet == j
            up, down = log.inputs.up[mine], log.inputs.down[mine]
            far = 1.0 if log.inputs.share is None else log.inputs.share[mine]
            for k in range(len(begin)):
                on[k, j] = np.sum(
                    far * (np.minimum(down, end[k]) - np.maximum(up, begin[k])).clip(0.0)
                )
    return on


def noise_of_poses(logs: Sequence[MotionLog]) -> tuple[float, float]:
    """White noise of position [m] and heading [rad]: from parabolas through five poses."""
    base = np.vander(np.arange(5.0), 3)
    off = np.eye(5) - base @ np.linalg.pinv(base)
    middle = off[2]
    left = []
    for log in logs:
        for rows in stretches(log):
            pose = log.pose[rows]
            if len(pose) >= 5:
                left.append(np.stack([np.convolve(pose[:, a], middle[::-1], "valid")
                                      for a in range(3)], axis=1))  # fmt: skip
    if not left:
        return 0.0, 0.0
    size = np.median(np.abs(np.concatenate(left)), axis=0) / 0.6745 / np.linalg.norm(middle)
    return float(np.mean(size[:2])), float(size[2])


def whiteness(ahead: HorizonErrors) -> float | None:
    """Correlation of successive 1 s errors that share no time; 0 is white."""
    error, t = ahead.error[:, :2], ahead.t
    skip = round((BEFORE + ahead.horizon) / EVERY)
    if len(error) < 3 * skip:
        return None
    near = np.abs(t[skip:] - t[:-skip] - skip * EVERY) < 0.01
    a, b = error[:-skip][near], error[skip:][near]
    power = float(np.sum(a * a) + np.sum(b * b))
    return float(2.0 * np.sum(a * b) / power) if power > 0.0 and len(a) > 3 else None


def by_jet(ahead: HorizonErrors, vehicle: Vehicle) -> list[float | None]:
    """For each jet, how its open time goes with an error along its push (correlation)."""
    found: list[float | None] = []
    for j, jet in enumerate(vehicle.jets):
        c, s = np.cos(ahead.heading), np.sin(ahead.heading)
        push = c * jet.push[0] - s * jet.push[1], s * jet.push[0] + c * jet.push[1]
        along = ahead.error[:, 0] * push[0] + ahead.error[:, 1] * push[1]
        on = ahead.on[:, j]
        if len(on) < 10 or np.ptp(on) < 1e-3:
            found.append(None)
            continue
        found.append(float(np.corrcoef(on, along)[0, 1]))
    return found


def by_region(ahead: HorizonErrors) -> list[dict[str, Any]]:
    """RMS error in the four quarters around the median position."""
    if len(ahead.t) < 8:
        return []
    middle = np.median(ahead.at, axis=0)
    rows = []
    for right in (False, True):
        for upper in (False, True):
            inside = (ahead.at[:, 0] > middle[0]) == right
            inside &= (ahead.at[:, 1] > middle[1]) == upper
            if inside.any():
                size = np.sqrt(np.mean(np.sum(ahead.error[inside, :2] ** 2, axis=1)))
                rows.append({
                    "x_m": float(np.mean(ahead.at[inside, 0])),
                    "y_m": float(np.mean(ahead.at[inside, 1])),
                    "position_rms_m": float(size), "count": int(inside.sum()),
                })  # fmt: skip
    return rows


def validate(
    logs: Sequence[MotionLog], vehicle: Vehicle, against: Vehicle | None,
    table: Table | None = None,
) -> tuple[dict[str, Any], dict[str, list[HorizonErrors]]]:  # fmt: skip
    """All figures for --json, and the errors for the page; both vehicles are on the same table."""
    errors = {"vehicle": [errors_ahead(logs, vehicle, h, table) for h in HORIZONS]}
    if against is not None:
        errors["against"] = [errors_ahead(logs, against, h, table) for h in HORIZONS]
    of = {
        who: {f"{one.horizon:g}": one.figures() for one in found} for who, found in errors.items()
    }
    first, third = errors["vehicle"][0], errors["vehicle"][1]
    position, heading = noise_of_poses(logs)
    result: dict[str, Any] = {
        "horizons": {h: {who: of[who][h] for who in of} for h in of["vehicle"]},
        **{who: {"horizons": figures} for who, figures in of.items()},
        "noise": {"position_m": position, "heading_deg": float(np.degrees(heading))},
        "whiteness": whiteness(first),
        "by_jet": by_jet(first, vehicle),
        "by_region": by_region(third),
    }
    result["verdict"] = verdict(result)
    return result, errors


def verdict(result: dict[str, Any]) -> str:
    """The result of the validation in one sentence."""
    own = {h: one["vehicle"] for h, one in result["horizons"].items()}
    seen = {h: one for h, one in own.items() if one["count"]}
    if not seen:
        return "No prediction: the log has no undisturbed flight of two seconds."
    h = "3" if "3" in seen else max(seen, key=float)
    rms = 1e3 * seen[h]["position_rms_m"]
    words = [f"{h} s ahead the twin is {rms:.1f} mm off (RMS of {seen[h]['count']} predictions)"]
    other = result["horizons"][h].get("against")
    if other and other["count"] and other["position_rms_m"] > 0.0:
        ratio = seen[h]["position_rms_m"] / other["position_rms_m"]
        sense = "better than" if ratio < 0.95 else "worse than" if ratio > 1.05 else "as good as"
        words[0] += (
            f", {sense} the other file ({1e3 * other['position_rms_m']:.1f} mm, x {ratio:.2f})"
        )
    noise = 1e3 * result["noise"]["position_m"]
    words.append(f"the cameras' noise is {noise:.2g} mm")
    if result["whiteness"] is not None and abs(result["whiteness"]) > 0.3:
        words.append("the errors are not white: something steady is missing, such as a slope")
    jets = [k + 1 for k, c in enumerate(result["by_jet"]) if c is not None and abs(c) > 0.4]
    if jets:
        words.append(f"errors go with jet{'s' * (len(jets) > 1)} {', '.join(map(str, jets))}")
    return "; ".join(words) + "."
