"""`testbed calibrate mocap`: the cameras' latency, noise, axes, and the offset of the body.

Latency comes from a marker on a known angle: two sources on one clock, the truth (a servo, an
encoder) and the camera. The rest comes from a flight.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from testbed.identification.columns import LogRefusedError
from testbed.identification.motion import Calibration, identifiable, interval
from testbed.identification.motion_log import MotionLog
from testbed.identification.suspicion import look_at
from testbed.identification.validation import noise_of_poses

Array = NDArray[np.float64]
LONGEST = 1.0  # [s] latency
SLOWEST = 2.0  # [s] between two samples of a camera


def latency_of(
    truth_t: Array, truth: Array, camera_t: Array, camera: Array, where: str = ""
) -> dict[str, Any]:
    """Latency of the camera, gain and offset between the two, and noise; any unit of angle.

    Samples without a number are left out.

    Raises:
        LogRefusedError: the angle does not change enough, the sources do not overlap, or the
            latency is not that of a camera.
    """
    (truth_t, truth), (camera_t, camera) = _known(truth_t, truth), _known(camera_t, camera)
    for name, stamps in (("truth", truth_t), ("camera", camera_t)):
        if len(stamps) < 20 or np.any(np.diff(stamps) < 0.0):
            raise LogRefusedError(
                where=where, expected=f"20 samples of the {name} or more, in the order of time",
                found=f"{len(stamps)}" if len(stamps) < 20 else "a time before that of the last",
            )  # fmt: skip
    usual = float(np.median(np.diff(camera_t)))
    if usual > SLOWEST:
        raise LogRefusedError(
            where=where, expected=f"camera samples up to {SLOWEST:g} s apart",
            found=f"{usual:.4g} s", hint="times are in s; 1000 times off means ms",
        )  # fmt: skip
    start, end = truth_t[0] + LONGEST, min(truth_t[-1], camera_t[-1])
    inside = (camera_t >= start) & (camera_t <= end)
    if inside.sum() < 20:
        raise LogRefusedError(
            where=where, expected="20 camera samples beside the truth", found=f"{inside.sum()}"
        )
    t, y = camera_t[inside], camera[inside]

    def left(p: Array) -> Array:
        return p[1] * np.interp(t - p[0], truth_t, truth) + p[2] - y

    tried = []
    for shift in np.arange(0.0, LONGEST, 0.01):
        x = np.interp(t - shift, truth_t, truth)
        a = np.stack([x, np.ones(len(x))], axis=1)
        gain, offset = np.linalg.lstsq(a, y, rcond=None)[0]
        tried.append((float(np.median(np.abs(a @ (gain, offset) - y))), shift, gain, offset))
    _, *first = min(tried)
    size = max(1e-9, 1.5 * min(tried)[0])
    fit = least_squares(left, first, loss="soft_l1", f_scale=size, diff_step=1e-4)
    jacobian = fit.jac
    noise = float(np.median(np.abs(fit.fun)) / 0.6745)
    spread = float(np.sqrt(np.mean(left(fit.x) ** 2)))
    try:
        covariance = np.linalg.inv(jacobian.T @ jacobian) * spread**2
    except np.linalg.LinAlgError:
        covariance = np.full((3, 3), np.inf)
    sigma = float(np.sqrt(covariance[0, 0]))
    if not sigma < 0.1 or abs(fit.x[1]) < 0.2:
        raise LogRefusedError(
            where=where, expected="an angle that both sources see moving",
            found="no common motion: the latency is not identifiable",
        )  # fmt: skip
    late, reach = float(fit.x[0]), 1.96 * sigma
    if not -reach <= late <= LONGEST - 0.01:
        raise LogRefusedError(
            where=where, expected=f"a latency of 0 to {LONGEST:g} s", found=f"{late:.4g} s",
            hint="the camera sees no motion before it happens: are the sources exchanged"
            " (--camera), or their times of two clocks?" if late < 0.0
            else "are the times of two clocks? They are in s",
        )  # fmt: skip
    return {
        "latency_s": late, "low_s": late - reach, "high_s": late + reach, "gain": float(fit.x[1]),
        "offset": float(fit.x[2]), "noise": noise, "residual_rms": spread, "samples": len(t),
    }  # fmt: skip


def _known(t: Array, values: Array) -> tuple[Array, Array]:
    """The samples that have both numbers."""
    known = np.isfinite(t) & np.isfinite(values)
    return t[known], values[known]


def seen_in_flight(log: MotionLog, found: Calibration) -> dict[str, Any]:
    """Noise of a pose, what the axes look like, and the centre of mass in the cameras' body.

    Args:
        log: a flight.
        found: the calibration of its vehicle from this log. Single jets are fitted there, too:
            with equal jets their differences look like a centre of mass somewhere else.
    """
    look = look_at([log], found.model.vehicle)
    position, heading = noise_of_poses([log])
    names = {"delay": "delay", "com_x": "body_offset_x", "com_y": "body_offset_y"}
    rows = {}
    for own, name in names.items():
        k, sense = found.model.index(own), 1.0 if own == "delay" else -1.0
        ends = [sense * one for one in interval(found, k)]
        rows[name] = {
            "value": sense * float(found.estimate.p[k]) + 0.0, "low": min(ends), "high": max(ends),
            "unit": found.model.parameters[k].unit, "identifiable": identifiable(found, k),
        }  # fmt: skip
    return {
        "noise_m": position, "noise_deg": float(np.degrees(heading)),
        "axes": look.other or "as the mapping says",
        "explained_by_commands": float(look.plain),
        **rows,
    }  # fmt: skip
