"""Checks that a log is what its mapping says, before anything is fitted.

The second integral of the commanded acceleration, turned by the measured heading, must look like
the measured path. In complex numbers, a scaled, turned or mirrored path is the predicted one (or
its conjugate) times a complex number; so wrong units, axes and signs are told from one regression
each.
"""

import cmath
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_twin.schedule import Schedule
from testbed.core.vehicle import Vehicle
from testbed.identification.columns import LogRefusedError
from testbed.identification.model import VehicleModel
from testbed.identification.motion_log import MotionLog
from testbed.identification.prediction import Valves, Wrenches
from testbed.identification.windows import tiled

Array = NDArray[np.float64]
GRID = 0.02  # [s]
DELAYS = np.arange(0.0, 0.85, 0.05)  # [s] tried
TILE = 3.0  # [s]
CLEARLY = 0.12  # of explained variance, by which another reading must be better
HARDLY = 0.01  # the same between other readings
TELLS = 0.2  # explained share of the motion that tells the axes
DOUBTFUL = 0.5  # a smaller share may be the table's
UNEXPLAINED = 0.04  # on a table with steep slopes little of the motion is commanded
FARTHER = 5.0  # than the pose before the last: it is another vehicle's
SAME_PLACE = 0.005  # [m] of a jet
SAME_MASS = 0.05  # relative
STILL = 0.12  # of the motion that the commands ask for: less is no motion
LEAST = (3e-4, 3e-4, 1e-3)  # [m, m, rad] of that motion, to say so
ASIDE = 0.07  # [rad] by which the motion may go aside of the commands: 4 deg
SURELY = 5.0  # standard deviations
ENOUGH = 8  # windows that tell that angle
LOST = 100.0  # [m] from the other poses
UNITS = {
    "mm read as m": 1e3, "cm read as m": 1e2, "inches read as m": 39.37, "m read as cm": 1e-2,
    "m read as mm": 1e-3,
}  # fmt: skip


class Suspicion(NamedTuple):
    """Something wrong with a log, by name, and in words."""

    name: str
    text: str
    refuses: bool = True  # nothing is fitted


class MappingFit(NamedTuple):
    """How well commands explain a log."""

    plain: float  # explained share of the motion with the mapping as it is, positive scale
    scale: float  # measured over predicted acceleration
    turn: float  # explained share of the rotation
    turn_scale: float
    other: str  # the reading that explains most
    explained: float  # its share
    delay: float  # [s]
    aside: float  # angle from the commanded to the measured motion [rad]
    aside_sigma: float


def look_at(logs: Sequence[MotionLog], vehicle: Vehicle, *, steep: bool = False) -> MappingFit:
    """Compare commands and motion of some logs together; `steep` leaves steady pushes out."""
    parts = [_Parts(log, vehicle, steep) for log in logs]
    parts = [part for part in parts if part.windows]
    if not parts:
        raise LogRefusedError(
            where=", ".join(log.where for log in logs),
            expected=f"undisturbed flight of {0.5 * TILE:g} s or more in one piece",
            found="none", hint="see [use] of the mapping, --from and --until",
        )  # fmt: skip
    best: tuple[float, MappingFit] | None = None
    for delay in DELAYS:
        look = _judge([part.at(delay) for part in parts], delay)
        score = look.explained + 0.5 * look.turn
        if best is None or score > best[0]:
            best = score, look
    assert best is not None
    return best[1]


def start_of(model: VehicleModel, logs: Sequence[MotionLog], vehicle: Vehicle) -> Array:
    """A start near the solution: delay and scale from the regression of the check."""
    look = look_at(logs, vehicle)
    p = model.prior.copy()
    p[model.index("delay")] = look.delay - vehicle.command_delay_s
    if model.valves:
        p[0] = float(np.clip(look.scale, 0.3, 2.0))
    return p


class _Parts:
    """One log on a regular grid, cut in windows."""

    def __init__(self, log: MotionLog, vehicle: Vehicle, steep: bool) -> None:
        self.log = log
        valves = isinstance(log.inputs, Valves)
        model = VehicleModel(vehicle, valves=valves)
        p = model.prior.copy()
        p[model.index("delay")] = 0.0
        schedule, plant, _ = model.build(p, log.inputs)
        self.windows = []  # rows of each window, and a basis of what is left out of it
        for rows in tiled(log, TILE).rows:
            line = np.vander(log.t[rows] - log.t[rows[0]], 3 if steep else 2)
            self.windows.append((rows, np.linalg.qr(line)[0]))
        self.grid = np.arange(log.t[0] - 1.0, log.t[-1] + GRID, GRID)
        wrench = _means(schedule, self.grid)
        self.force = (wrench[:, 0] + 1j * wrench[:, 1]) / plant.mass[0]
        com = plant.com[0]
        self.spin = (wrench[:, 2] - com[0] * wrench[:, 1] + com[1] * wrench[:, 0]) / plant.inertia
        heading = np.interp(self.grid, log.t, log.pose[:, 2])
        in_table = isinstance(log.inputs, Wrenches) and log.inputs.in_table
        h = heading * (0.0 if in_table else 1.0)
        half = 2.0 * np.arcsin(np.clip(h, -1.0, 1.0))
        self.turns = [np.exp(1j * f * h) for f in (1.0, -1.0, 57.29578, 1 / 57.29578)]
        self.turns += [np.exp(1j * half) * (np.abs(h).max() <= 1.0)]
        self.turns += [np.exp(1j * heading) if in_table else np.ones(len(h))]

    def at(self, delay: float) -> list[Array]:
        """Path, readings of the commands and heading, window by window.

        A straight line is left out of each, or a parabola: the push of a steep table.
        """
        shift = round(delay / GRID)
        force, spin = np.roll(self.force, shift), np.roll(self.spin, shift)
        force[:shift] = spin[:shift] = 0.0
        t, pose = self.log.t, self.log.pose
        columns = [pose[:, 0] + 1j * pose[:, 1], pose[:, 2]]
        columns += [_at(self.grid, _twice(force * turn), t) for turn in self.turns]
        stack = np.stack([*columns, _at(self.grid, _twice(spin), t)], axis=1)
        found: list[Array] = []
        for rows, basis in self.windows:
            own = stack[rows]
            found.append(own - basis @ (basis.T @ own))
        return found


READINGS = ("", "heading-sign", "unit-angle", "unit-angle", "quaternion", "frame")


def _judge(found: list[list[Array]], delay: float) -> MappingFit:
    windows = [one for part in found for one in part]
    # columns times columns of each window, as they are and for mirrored readings
    plainly = np.array([one.conj().T @ one for one in windows])
    mirrored = np.array([one.T @ one for one in windows])
    weights = np.ones(len(windows))
    for turn in range(2):
        both, other = np.tensordot(weights, plainly, 1), np.tensordot(weights, mirrored, 1)
        total, power = (max(float(both[k, k].real), 1e-18) for k in (0, 2))
        c = complex(both[2, 0] / power)
        if turn == 0:
            left = np.maximum(_left(plainly, c), 0.0)
            size = np.sqrt(left / list(map(len, windows)))
            limit = 2.0 * max(float(np.median(size)), 1e-9)
            weights = np.minimum(1.0, limit / np.maximum(size, 1e-12))
    scale = c.real
    plain = 1.0 - float(_left(both, max(scale, 0.0))) / total
    pull = weights * np.imag(np.conj(c) * plainly[:, 2, 0])
    aside_sigma = float(np.sqrt(np.sum(np.square(pull)))) / max(abs(c) ** 2 * power, 1e-18)
    aside = cmath.phase(c)
    best, explained = "", plain
    for k, reading in enumerate(READINGS, 2):
        own = max(float(both[k, k].real), 1e-18)
        for mirror, cross in enumerate((both[k, 0], other[k, 0])):
            share = 1.0 - float(both[0, 0].real - abs(cross) ** 2 / own) / total
            if share > explained + (HARDLY if best else CLEARLY * (explained < 0.999)):
                best, explained = _named(reading, bool(mirror), complex(cross / own)), share
    asked, together, turned = (float(both[k].real) for k in ((-1, -1), (-1, 1), (1, 1)))
    turn_scale = together / max(asked, 1e-18)
    left = turned - 2.0 * turn_scale * together + turn_scale**2 * asked
    return MappingFit(
        plain, scale, 1.0 - left / max(turned, 1e-18), turn_scale, best, explained, delay, aside,
        aside_sigma,
    )  # fmt: skip


def _left(both: Array, c: complex) -> Any:
    """Square of the path without `c` times the first reading, from columns times columns."""
    cross = np.real(np.conj(c) * both[..., 2, 0])
    return both[..., 0, 0].real - 2.0 * cross + abs(c) ** 2 * both[..., 2, 2].real


def _named(reading: str, mirrored: bool, c: complex) -> str:
    if reading:
        return reading
    quarter = round(cmath.phase(c) / (np.pi / 2)) % 4
    if mirrored:
        return ("mirrored-y", "axes-swapped", "mirrored-x", "axes-swapped")[quarter]
    return ("frame-turned", "frame-turned", "signs-turned", "frame-turned")[quarter]


WORDS = {
    "heading-sign": "the heading counts clockwise; expected counter-clockwise; or the valves are"
    " counted the other way round",
    "unit-angle": "the heading is in degrees where the mapping says rad, or the reverse",
    "quaternion": "the heading is a component of a quaternion; see `quaternion` of the mapping",
    "frame": "the forces are in the other frame: table and body are exchanged",
    "mirrored-y": "y points the other way: the axes are not right-handed",
    "mirrored-x": "x points the other way: the axes are not right-handed",
    "axes-swapped": "x and y are exchanged",
    "frame-turned": "the axes of the log are turned against the heading, or the valves are counted"
    " from another jet",
    "signs-turned": "forces and motion have opposite signs: x and y reversed, heading off by pi,"
    " or 1 and 0 of the valves exchanged",
}


def suspicions(logs: Sequence[MotionLog], vehicle: Vehicle) -> Iterator[Suspicion]:
    """Suspicions about the logs as a whole: units, axes, delay."""
    if not any(log.whole.any() for log in logs):
        look_at(logs, vehicle)  # refuses them
    flown = [one for log in logs for one in _other_than_flown(log, vehicle)]
    if flown:
        yield from flown
        return
    implausible = [one for log in logs for one in _plausible(log)]
    if implausible:
        yield from implausible
        return
    found = look_at(logs, vehicle)
    unit = min(UNITS, key=lambda name: abs(np.log(abs(found.scale) / UNITS[name] + 1e-30)))
    if 0.3 < found.scale / UNITS[unit] < 3.0 and found.plain > 0.2:
        text = f"positions move {found.scale:.3g} times as far as commanded: {unit}?"
        yield Suspicion("unit-position", f"{text} Or open times in another unit")
        return
    for factor, unit in ((57.3, "degrees"), (1 / 57.3, "radians")):
        if 0.4 < found.turn_scale / factor < 2.5 and found.turn > 0.2:
            text = f"the heading turns {found.turn_scale:.3g} times as far as commanded: in {unit}?"
            yield Suspicion("unit-angle", text)
            return
    unsteady = [_Parts(log, vehicle, steep=True).at(found.delay) for log in logs]
    still = _still(logs, [window for part in unsteady for window in part])
    if still:
        yield Suspicion("no-motion", still)
        return
    axes = steep = found
    if found.plain < DOUBTFUL:  # a steep table pushes too: judge by what is not steady
        steep = look_at(logs, vehicle, steep=True)
        axes = steep if steep.explained > TELLS else found
    if axes.other and axes.explained > max(TELLS, axes.plain + CLEARLY):
        yield Suspicion(
            axes.other,
            f"{WORDS[axes.other]}: so the commands explain {axes.explained:.0%} of the motion,"
            f" as the mapping says only {max(0.0, axes.plain):.0%}",
        )
        return
    if found.plain < UNEXPLAINED and _is_right(found.turn, found.turn_scale, steep.scale):
        yield Suspicion(
            "little-motion",
            f"the commands explain only {max(0.0, found.plain):.0%} of the path, and"
            f" {found.turn:.0%} of the rotation: a vehicle that holds its place on a slope tells"
            " little; let it move farther, see `testbed excite`",
            refuses=False,
        )
    elif found.plain < UNEXPLAINED:
        yield Suspicion(
            "unexplained",
            f"the commands explain only {max(0.0, found.plain):.0%} of the motion: another log's"
            " commands, another vehicle, swapped columns or a clock error",
        )
        return
    turns = any(np.ptp(log.pose[:, 2]) > 0.3 for log in logs)
    if found.turn_scale < -0.2 and found.turn > 0.3 and turns:
        text = "the vehicle turns against its commanded torque: heading or jets mirrored"
        yield Suspicion("heading-sign", text)
    elif aside := _aside(unsteady):
        yield Suspicion("heading-off", aside, refuses=False)


def _aside(parts: list[list[Array]]) -> str:
    """By how much the motion goes aside of the commands, steady pushes apart; or nothing."""
    look = _judge(parts, 0.0)
    sure = look.plain > DOUBTFUL and sum(map(len, parts)) >= ENOUGH
    if not sure or abs(look.aside) < max(ASIDE, SURELY * look.aside_sigma):
        return ""
    return (
        f"the vehicle moves {np.degrees(look.aside):+.1f} deg aside of its commands: its body in"
        " motion capture is turned against its file by so much, or its nozzles are"
    )


def _still(logs: Sequence[MotionLog], windows: Sequence[Array]) -> str:
    """What hardly moves where the commands ask for motion, steady pushes apart; or nothing."""
    stack = np.concatenate(windows)
    seen = (stack[:, 1].real, stack[:, 0].real, stack[:, 0].imag)
    asked = (stack[:, -1].real, stack[:, 2].real, stack[:, 2].imag)
    torque = any(
        isinstance(log.inputs, Valves) or bool(np.any(log.inputs.wrench[:, 2])) for log in logs
    )
    names, units = ("the heading", "x", "y"), ("rad", "m", "m")
    for k in range(0 if torque else 1, 3):
        there, wanted = (float(np.sqrt(np.mean(one[k] ** 2))) for one in (seen, asked))
        if wanted > LEAST[2 - k] and there < STILL * wanted:
            other = "a quaternion in another order or frame" if k == 0 else "the height"
            return (
                f"{names[k]} moves by {there:.2g} {units[k]} where the commands ask for"
                f" {wanted:.2g} {units[k]}: a constant column, {other}, or no air"
            )
    return ""


def _is_right(turn: float, turn_scale: float, scale: float) -> bool:
    """Whether the rotation, and the path without steady pushes, are those of the commands."""
    return turn > DOUBTFUL and 0.5 < turn_scale < 2.0 and 0.3 < scale < 3.0


def _other_than_flown(log: MotionLog, vehicle: Vehicle) -> Iterator[Suspicion]:
    """A log that tells its vehicle: mass and jets must be the file's."""
    own = log.vehicle
    if own is None:
        return
    flown, file = ([(*jet.position, *jet.push) for jet in one.jets] for one in (own, vehicle))
    apart = len(flown) != len(file) or not np.allclose(flown, file, atol=SAME_PLACE)
    what = [f"a mass of {own.mass:g} kg, the file has {vehicle.mass:g} kg"]
    what *= abs(own.mass / vehicle.mass - 1.0) > SAME_MASS
    what += ["jets at other places than the file's"] * apart
    if what:
        text = f"{log.where}: it was flown with {' and '.join(what)}"
        yield Suspicion("other-vehicle", text)


def _plausible(log: MotionLog) -> Iterator[Suspicion]:
    kept = log.pose[log.whole]
    if not len(kept):
        return
    one, two = (np.median(np.hypot(*(kept[k:, :2] - kept[:-k, :2]).T)) for k in (1, 2))
    if len(kept) > 2 and one > 0.05 and one > FARTHER * two:
        text = f"{log.where}: every second pose is {one:.2g} m away: two vehicles in one file?"
        yield Suspicion("two-vehicles", text + " [rows] of the mapping chooses one")
        return
    reach = np.ptp(kept[:, :2], axis=0)
    apart = np.abs(kept[:, :2] - np.median(kept[:, :2], axis=0)).max(axis=1) > LOST
    if 0 < apart.sum() < 0.3 * len(kept):
        text = f"{log.where}: {apart.sum()} of {len(kept)} poses are more than {LOST:g} m from the"
        yield Suspicion("lost-poses", f"{text} others: a lost body's? Leave such cells empty")
    elif reach.max() > LOST:
        yield Suspicion("unit-position", f"{log.where}: the path spans {reach.max():.4g} m: in mm?")
    elif max(reach.max(), 0.2 * float(np.ptp(kept[:, 2]))) < 1e-3:
        yield Suspicion("no-motion", f"{log.where}: the vehicle moves less than 1 mm")
    step = np.abs(np.diff(kept[:, 2]))
    dt = np.diff(log.t[log.whole])
    if len(step) and float(np.quantile(step / dt, 0.9)) > 6.0:
        text = f"{log.where}: the heading turns faster than a turn per second: degrees read as rad?"
        text += " Or a wrong unit of time"
        yield Suspicion("unit-angle", text)


def _means(schedule: Schedule, grid: Array) -> Array:
    """Mean wrenches over the cells around the points of a grid; a pulse may be shorter than one."""
    start, value, slope = schedule
    width = np.diff(start)[:, None]
    impulse = np.zeros((len(start), value.shape[1]))
    np.cumsum(width * (value + 0.5 * width * slope), axis=0, out=impulse[1:])
    edges = np.clip(np.append(grid - 0.5 * GRID, grid[-1] + 0.5 * GRID), start[0], start[-1])
    k = np.minimum(np.searchsorted(start, edges, side="right") - 1, len(value) - 1)
    after = (edges - start[k])[:, None]
    return np.diff(impulse[k] + after * (value[k] + 0.5 * after * slope[k]), axis=0) / GRID


def _twice(a: Array) -> Array:
    """Second integral on the grid."""
    v = np.concatenate([[0.0], np.cumsum(0.5 * (a[1:] + a[:-1]))]) * GRID
    return np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]))]) * GRID


def _at(grid: Array, values: Array, t: Array) -> Array:
    if np.iscomplexobj(values):
        return np.interp(t, grid, values.real) + 1j * np.interp(t, grid, values.imag)
    return np.interp(t, grid, values)
