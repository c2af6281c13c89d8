"""Verdicts on the cameras: of standing bodies, and of bodies that a person carries."""

from collections.abc import Mapping, Sequence

import numpy as np

from testbed.commission.motion import Array, noise_of, unwrapped
from testbed.commission.verdict import Verdict
from testbed.core.se2 import wrap
from testbed.core.table import Mocap, Table

STEP = "cameras"
RATE = 0.9  # least share of the file's rate
NOISY = 3.0  # times the file's noise
FINE = 1e-4, 0.02  # noise below this is never too much [m, deg]
UNITS = ((1000.0, "mm"), (100.0, "cm"), (0.001, "km"), (39.37, "inch"))
NEAR = 0.08  # a person puts a vehicle this near to a mark [m]
STRAIGHT = 15.0  # and this straight [deg]
FRAMES = {  # what the cameras make of the table's axes; columns are their images
    "": ((1.0, 0.0), (0.0, 1.0)),
    "turned by 90 deg": ((0.0, -1.0), (1.0, 0.0)),
    "turned by 180 deg": ((-1.0, 0.0), (0.0, -1.0)),
    "turned by -90 deg": ((0.0, 1.0), (-1.0, 0.0)),
    "mirrored: y is reversed": ((1.0, 0.0), (0.0, -1.0)),
    "mirrored: x is reversed": ((-1.0, 0.0), (0.0, 1.0)),
    "mirrored: x and y are exchanged": ((0.0, 1.0), (1.0, 0.0)),
    "mirrored: x and y are exchanged and reversed": ((0.0, -1.0), (-1.0, 0.0)),
}
Mark = tuple[float, float, float]  # x, y [m], heading [rad], where a person puts the vehicle


def standing(name: str, rows: Array, seconds: float, table: Table) -> Verdict:
    """Rate, noise, units and life of one body that stands still."""
    mocap: Mocap = table.mocap
    rate = len(rows) / seconds
    if len(rows) < 8:
        text = f"{len(rows)} poses in {seconds:g} s: body not tracked, or streamed by another name"
        return Verdict(STEP, name, text, "no_poses", {"rate_hz": rate})
    noise = noise_of(rows)
    spin = float(np.degrees(noise.heading))
    numbers = {"rate_hz": rate, "noise_m": noise.place, "noise_deg": spin}

    def bad(code: str, text: str) -> Verdict:
        return Verdict(STEP, name, text, code, numbers)

    x, y = np.abs(np.median(rows[:, 1:3], axis=0))
    if max(x / table.size[0], y / table.size[1]) > 5.0:
        unit = next(u for f, u in UNITS if f > 5.0 and max(x, y) / f < max(table.size))
        return bad("units", f"stands {max(x, y):.0f} m from the middle: {unit} for m?")
    if rate < RATE * mocap.rate_hz:
        return bad("camera_rate", f"{rate:.0f} Hz, the table file says {mocap.rate_hz:g} Hz")
    if not np.ptp(rows[:, 1:], axis=0).any():
        return bad("camera_frozen", "the pose does not change by a bit: the stream is frozen")
    limits = (max(NOISY * mocap.noise, FINE[0]), max(NOISY * mocap.noise_deg, FINE[1]))
    if noise.place > limits[0] or spin > limits[1]:
        text = (
            f"noise {1e3 * noise.place:.2f} mm and {spin:.2f} deg; the table file says"
            f" {1e3 * mocap.noise:g} mm and {mocap.noise_deg:g} deg"
        )
        return bad("camera_noise", text)
    text = f"{rate:.0f} Hz, noise {1e3 * noise.place:.2f} mm and {spin:.3f} deg"
    return Verdict(STEP, name, text, numbers=numbers)


def carried(name: str, marks: Sequence[Mark], seen: Mapping[str, Sequence[Array]]) -> Verdict:
    """Frame, units, body and heading, from a vehicle that was carried from mark to mark.

    Args:
        name: the vehicle that was carried.
        marks: four: a place; away from it along x; along y; the place again, a quarter turn left.
        seen: for every body of the cameras its poses at each mark.
    """
    step = "frame"
    places = {body: np.array([_middle(rows) for rows in all_]) for body, all_ in seen.items()}
    moved = {body: float(np.ptp(at[:, :2], axis=0).max()) for body, at in places.items()}
    way = float(np.hypot(marks[1][0] - marks[0][0], marks[1][1] - marks[0][1]))
    at, set_down = places[name], np.array(marks)
    others = [body for body, far in moved.items() if body != name and far > 0.3 * way]
    if not moved[name] > 0.3 * way and others:
        text = f"carried, but the cameras moved {others[0]}: bodies exchanged, or a wrong body"
        return Verdict(step, name, text, "bodies_swapped")
    if not moved[name] > 0.0003 * way:
        return Verdict(step, name, "carried, but the cameras show no motion", "wrong_body")
    ways = set_down[1:3, :2] - set_down[0, :2]
    steps = at[1:3, :2] - at[0, :2]
    scale = float(np.sqrt(np.sum(steps**2) / np.sum(ways**2)))
    numbers = {"scale": scale}
    for factor, unit in UNITS:
        if 0.8 < scale / factor < 1.25:
            return Verdict(step, name, f"{unit} for m: scale {scale:.3g}", "units", numbers)
    sizes = np.hypot(*steps.T) / np.hypot(*ways.T)
    if sizes.min() < 0.25 < 0.7 < sizes.max():
        still = "xy"[int(np.argmin(sizes))]
        text = f"carried along {still}, the pose stays: is `up` of [lab.mocap] the axis upwards?"
        return Verdict(step, name, text, "up_axis", numbers)
    if not 0.8 < scale < 1.25:
        text = f"moves {scale:.2f} times as far as it was carried"
        return Verdict(step, name, text, "scale", numbers)
    frame = min(FRAMES, key=lambda word: _left(ways, steps, FRAMES[word]))
    if _left(ways, steps, FRAMES[frame]) > 0.3 * way:
        return Verdict(step, name, "moves unlike it was carried", "frame", numbers)
    if frame:
        code = "frame_mirrored" if "mirrored" in frame else "frame_turned"
        return Verdict(step, name, f"the cameras' frame is {frame}", code, numbers)
    return _of_heading(name, set_down, at, numbers)


def _of_heading(name: str, set_down: Array, at: Array, numbers: dict[str, float]) -> Verdict:
    step = "frame"
    turn = np.degrees(wrap(at[3, 2] - at[0, 2]))
    off = np.degrees(
        np.angle(np.mean(np.exp(1j * (at[:, 2] - set_down[:, 2]))))
    )  # of the body's forward axis
    numbers = {**numbers, "turn_deg": float(turn), "heading_off_deg": float(off)}
    if abs(turn + 90.0) < 2.0 * STRAIGHT:
        text = "turned to the left, the heading falls: mirrored"
        return Verdict(step, name, text, "frame_mirrored", numbers)
    if abs(turn - 90.0) > 2.0 * STRAIGHT:
        text = f"turned by 90 deg, the heading by {turn:.0f} deg: is `up` the axis upwards?"
        return Verdict(step, name, text, "up_axis", numbers)
    if abs(off) > STRAIGHT:
        text = f"the body's forward axis is {off:.0f} deg off: register it along the vehicle's x"
        return Verdict(step, name, text, "body_turned", numbers)
    swing = at[3, :2] - at[0, :2] - (set_down[3, :2] - set_down[0, :2])
    # a quarter turn about a pivot at r from the middle moves it by (R - 1) r
    from_middle = np.linalg.solve([[-1.0, -1.0], [1.0, -1.0]], swing)
    pivot = float(np.hypot(*from_middle))
    origin = np.mean(at[:3, :2] - set_down[:3, :2], axis=0) - from_middle
    numbers |= {"origin_x_m": float(origin[0]), "origin_y_m": float(origin[1]), "pivot_m": pivot}
    if pivot > NEAR / 2.0:
        text = f"turned on the spot, it moves: its pivot is {100 * pivot:.0f} cm from the middle"
        return Verdict(step, name, text, "pivot", numbers)
    if np.hypot(*origin) > NEAR:
        text = f"the origin is ({origin[0]:+.2f}, {origin[1]:+.2f}) m off"
        return Verdict(step, name, text, "origin", numbers)
    text = f"axes right, scale {numbers['scale']:.2f}, heading within {abs(off):.0f} deg"
    return Verdict(step, name, text, numbers=numbers)


def _middle(rows: Array) -> Array:
    return np.median(unwrapped(rows)[:, 1:], axis=0) if len(rows) else np.full(3, np.nan)


def _left(ways: Array, steps: Array, frame: Sequence[Sequence[float]]) -> float:
    """Largest distance between where it was carried, seen in this frame, and where it was seen."""
    return float(np.hypot(*(steps - ways @ np.array(frame)).T).max())
