"""Verdict on a vehicle that floats without commands: a slope, a hose, or a valve that leaks."""

from collections.abc import Sequence

import numpy as np

from testbed.commission.motion import Array, Drift
from testbed.commission.verdict import Verdict
from testbed.core.jets import effect_matrix
from testbed.core.table import Spread
from testbed.core.vehicle import Vehicle

STEP = "float"
SLOPE = 0.003  # a slope that the file does not know is healthy up to this [m/s^2]
LEAST = 0.03  # smallest leak, as a share of thrust
SURE = 5.0  # standard deviations
LIKELY = 9.0  # largest misfit of a leak, in variances
INEXACT = 0.15  # error of a jet's wrench in the file, as a share of what is found
FLOOR = 3e-4, 2e-3  # errors that noise does not explain: a bump, a draught [m/s^2, rad/s^2]


def afloat(
    name: str, vehicle: Vehicle, drifts: Sequence[Drift], slopes: Sequence[Array], lab: Spread
) -> Verdict:
    """Judge the drifts at one or two headings.

    Args:
        name: of the vehicle.
        vehicle: as in its file.
        drifts: at opposite headings, or at one.
        slopes: of the table file at the drifts' places [m/s^2].
        lab: what the files do not know.
    """
    floor = np.hypot(FLOOR, (lab.hose / vehicle.mass, lab.hose_torque / vehicle.inertia))
    beyond = np.array([d.accel[:2] - slope for d, slope in zip(drifts, slopes, strict=True)])
    alpha = float(np.mean([d.accel[2] for d in drifts]))
    push_sigma = float(np.hypot(max(d.sigma[0] for d in drifts), floor[0]))
    turn_sigma = float(np.hypot(max(d.sigma[2] for d in drifts), floor[1]))
    turned = [_in_body(row, d.pose[2]) for row, d in zip(beyond, drifts, strict=True)]
    if len(drifts) == 2:  # a slope changes its sign in the body, a jet does not
        body, table = 0.5 * (turned[0] + turned[1]), 0.5 * (beyond[0] + beyond[1])
    else:
        body, table = turned[0], beyond[0]
    numbers = {
        "slope_x_m_s2": float(table[0]), "slope_y_m_s2": float(table[1]),
        "body_x_m_s2": float(body[0]), "body_y_m_s2": float(body[1]),
        "turn_rad_s2": alpha,
    }  # fmt: skip
    found = np.array([*body, alpha])
    # from one heading, a healthy slope may be a jet's push
    jet_sigma = push_sigma if len(drifts) == 2 else float(np.hypot(push_sigma, SLOPE))
    sigma = np.array([jet_sigma, jet_sigma, turn_sigma])
    weight = np.array([vehicle.mass, vehicle.mass, vehicle.inertia])
    columns = effect_matrix(vehicle.jets, about=vehicle.com) / weight[:, None]
    if np.abs(found / sigma).max() > SURE:
        loose = np.hypot(sigma, INEXACT * _sizes(found, columns))
        fits = [_leak(found / loose, column / loose) for column in columns.T]
        jet = int(np.argmin([left for _, left in fits]))
        share, left = fits[jet]
        if share > LEAST and left < LIKELY:
            text = f"jet {jet + 1} pushes without a command: {share:.0%} of its thrust"
            return Verdict(STEP, name, text, "leak", {**numbers, "share": share})
        if abs(alpha) > SURE * turn_sigma:
            text = f"it is turned by {vehicle.inertia * alpha:+.4f} N m, and by no jet: a hose?"
            return Verdict(STEP, name, text, "hose", numbers)
        text = f"it is pushed by {1e3 * np.hypot(*body):.0f} mm/s^2 in its own frame: a leak?"
        return Verdict(STEP, name, text, "pushed", numbers)
    size = float(np.hypot(*table))
    if size > np.hypot(SLOPE, SURE * push_sigma):
        text = (
            f"it is pulled by {1e3 * size:.1f} mm/s^2 ({size * vehicle.mass:.2f} N) that the table"
            " file does not know: a hose, or a table that is not level"
        )
        if len(drifts) == 1:
            text += ", or a jet that leaks: turn it by 180 degrees to tell"
        return Verdict(STEP, name, text, "pulled", numbers)
    turn = 1e3 * abs(alpha)
    text = f"{1e3 * size:.1f} mm/s^2 beyond the table file's slope, turned by {turn:.1f} mrad/s^2"
    return Verdict(STEP, name, text, numbers=numbers)


def _in_body(push: Array, theta: float) -> Array:
    c, s = np.cos(theta), np.sin(theta)
    return np.array([c * push[0] + s * push[1], c * push[1] - s * push[0]])


def _sizes(found: Array, columns: Array) -> Array:
    """How large the accelerations of jets are that turn or push as much as was found."""
    each = np.abs(columns).max(axis=1)
    return each * float(np.max(np.abs(found) / each))


def _leak(found: Array, column: Array) -> tuple[float, float]:
    """Share of the jet that fits best, and what it leaves, in variances."""
    share = max(0.0, float(found @ column / (column @ column)))
    return share, float(np.sum((found - share * column) ** 2))
