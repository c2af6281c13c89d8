"""Fits of poses, rows of (time [s], x, y [m], heading [rad]): at rest, and around a short push."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

EARLIEST, LATEST = -0.1, 0.3  # delays that are tried; the cameras' clock may be off [s]
FINEST = 1e-6  # smallest noise that is believed [m, rad]
REFITS = 4  # of a push whose drag is larger than the file's
FINE = 0.004  # between two delays [s]


class Noise(NamedTuple):
    """Noise of one pose: standard deviations."""

    place: float  # [m]
    heading: float  # [rad]

    @property
    def axes(self) -> Array:
        """Standard deviations of x, y and heading [m, m, rad], shape (3,)."""
        return np.array([self.place, self.place, self.heading])


class Drift(NamedTuple):
    """A vehicle that floats without commands."""

    accel: Array  # x, y, heading [m/s^2, rad/s^2]
    sigma: Array
    pose: Array  # mean


class Kick(NamedTuple):
    """The change of velocity by a push."""

    change: Array  # x, y in W, heading [m/s, rad/s]
    sigma: Array
    theta: float  # heading at the push
    delay: float  # from the command to the middle of the rise of the flow [s]
    delay_sigma: float
    drag: float  # deceleration over speed after the push, beyond the file's [1/s]
    drag_sigma: float
    misfit: float  # residual over noise


def unwrapped(rows: Array) -> Array:
    """The rows in order of time, with a continuous heading."""
    ordered = rows[np.argsort(rows[:, 0], kind="stable")].copy()
    ordered[:, 3] = np.unwrap(ordered[:, 3])
    return ordered


def noise_of(rows: Array) -> Noise:
    """Noise of a standing body, from neighbouring poses: a slow drift does not count."""
    steps = np.diff(unwrapped(rows)[:, 1:], axis=0) / np.sqrt(2.0)
    spread = np.sqrt(np.mean(steps**2, axis=0))
    place = float(np.hypot(*spread[:2]) / np.sqrt(2.0))
    return Noise(max(place, FINEST), max(float(spread[2]), FINEST))


def speed_of(rows: Array) -> float:
    """Mean speed over the rows [m/s]."""
    if len(rows) < 4:
        return 0.0
    t = rows[:, 0] - rows[:, 0].mean()
    return float(np.hypot(*(t @ rows[:, 1:3] / (t @ t))))


def _solve(design: Array, y: Array) -> tuple[Array, Array, float]:
    """Least squares: solution, its variances for unit noise, sum of squares left."""
    inverse = np.linalg.pinv(design.T @ design)
    found = inverse @ (design.T @ y)
    return found, np.diag(inverse), float(np.sum((y - design @ found) ** 2))


def drift_of(rows: Array, noise: Noise, drag: tuple[float, float] = (0.0, 0.0)) -> Drift:
    """Constant push of a floating body; `drag` as in `kick_of`."""
    rows = unwrapped(rows)
    t = rows[:, 0] - rows[0, 0]
    solved = [
        _solve(_from_speed(t, c), rows[:, 1 + axis])
        for axis, c in enumerate((drag[0], drag[0], drag[1]))
    ]
    accel = np.array([found[2] for found, _, _ in solved])
    sigma = noise.axes * np.sqrt([variance[2] for _, variance, _ in solved])
    return Drift(accel, sigma, rows[:, 1:].mean(axis=0))


def _from_speed(t: Array, drag: float) -> Array:
    """Ways by a place, a speed of 1 at t = 0, and a constant acceleration of 1."""
    if drag * float(t[-1]) < 1e-3:
        return np.stack([np.ones(len(t)), t, 0.5 * t * t], axis=1)
    coast = (1.0 - np.exp(-drag * t)) / drag
    return np.stack([np.ones(len(t)), coast, (t - coast) / drag], axis=1)


def kick_of(
    rows: Array, at: float, flow_s: float, noise: Noise, drag: tuple[float, float] = (0.0, 0.0)
) -> Kick:
    """A push on top of a constant acceleration; a drag that the file does not know is fitted.

    Args:
        rows: poses before, during and after it.
        at: time of the command [s].
        flow_s: length of the push [s].
        noise: of a pose.
        drag: deceleration over speed by the file, of motion and of turning [1/s].
    """
    beyond = 0.0
    for _ in range(REFITS):
        kick = _kick(rows, at, flow_s, noise, (max(0.0, drag[0] + beyond), drag[1]))
        beyond += kick.drag
        if abs(kick.drag) < 3.0 * kick.drag_sigma:
            break
    return kick._replace(drag=beyond)


def _kick(rows: Array, at: float, flow_s: float, noise: Noise, drag: tuple[float, float]) -> Kick:
    """A push with a known drag; its `drag` is what remains."""
    drags = (drag[0], drag[0], drag[1])
    rows = unwrapped(rows)
    s = rows[:, 0] - at
    base = [np.ones(len(s)), s, 0.5 * s * s]
    delays = np.arange(EARLIEST, LATEST, FINE)
    left = []
    for delay in delays:
        rests = [
            _solve(np.stack([*base, _pushed(s - delay, flow_s, c)], axis=1), rows[:, 1 + axis])[2]
            for axis, c in enumerate(drags)
        ]
        left.append(sum(r / sigma**2 for r, sigma in zip(rests, noise.axes, strict=True)))
    best = int(np.argmin(left))
    delay, delay_sigma = float(delays[best]), LATEST
    if 0 < best < len(delays) - 1:
        a, b, c = left[best - 1], left[best], left[best + 1]
        bend = a - 2.0 * b + c
        if bend > 0.0:
            delay += 0.5 * FINE * (a - c) / bend
            delay_sigma = FINE * float(np.sqrt(2.0 / bend))
    designs = [np.stack([*base, _pushed(s - delay, flow_s, c)], axis=1) for c in drags]
    solved = [_solve(designs[axis], rows[:, 1 + axis]) for axis in range(3)]
    change = np.array([found[3] for found, _, _ in solved])
    sigma = noise.axes * np.sqrt([variance[3] for _, variance, _ in solved])
    theta = float(np.interp(at + delay + 0.5 * flow_s, rows[:, 0], rows[:, 3]))
    slows, slows_sigma = _drag(rows, designs[0], s - delay, flow_s, change, noise.place)
    misfit = float(np.sqrt(left[best] / max(1, 3 * len(s) - 13)))
    return Kick(change, sigma, theta, delay, delay_sigma, slows, slows_sigma, misfit)


def mean_of(kicks: Sequence[Kick]) -> Kick:
    """The weighted mean of equal pushes, in the frame of the first."""
    first = kicks[0]
    if len(kicks) == 1:
        return first
    weights = np.array([k.sigma[0] ** -2.0 for k in kicks])
    weights /= weights.sum()
    changes = []
    for k in kicks:
        c, s = np.cos(first.theta - k.theta), np.sin(first.theta - k.theta)
        x, y, turn = k.change
        changes.append((c * x - s * y, s * x + c * y, turn))
    less = float(np.sqrt(np.sum(weights**2 * [k.sigma[0] ** 2 for k in kicks])) / first.sigma[0])
    rows = np.array([(k.delay, k.drag, k.misfit) for k in kicks])
    delay, drag, misfit = (weights @ rows).tolist()
    return Kick(
        weights @ np.array(changes), less * first.sigma, first.theta, delay,
        less * first.delay_sigma, drag, less * first.drag_sigma, misfit,
    )  # fmt: skip


def _pushed(s: Array, flow_s: float, drag: float) -> Array:
    """Way since a push that began at s = 0 and would change the velocity by 1 without drag."""
    if drag * max(1.0, float(s[-1])) > 1e-3:
        c, t = drag, np.clip(s, 0.0, flow_s)
        during = (t / c - (1.0 - np.exp(-c * t)) / c**2) / flow_s
        speed = (1.0 - np.exp(-c * flow_s)) / (c * flow_s)
        return during + speed * (1.0 - np.exp(-c * np.clip(s - flow_s, 0.0, None))) / c
    during, after = s * s / (2.0 * flow_s), s - 0.5 * flow_s
    return np.where(s <= 0.0, 0.0, np.where(s < flow_s, during, after))


def _drag(
    rows: Array, design: Array, s: Array, flow_s: float, change: Array, noise: float
) -> tuple[float, float]:
    """Deceleration over speed after the push, along it [1/s], and its error."""
    size = float(np.hypot(*change[:2]))
    if size == 0.0:
        return 0.0, np.inf
    along = rows[:, 1:3] @ (change[:2] / size)
    slowed = np.where(s < flow_s, 0.0, -0.5 * (s - 0.5 * flow_s) ** 2)
    if not slowed.any():  # no pose after the push
        return 0.0, np.inf
    found, variance, _ = _solve(np.column_stack([design, slowed]), along)
    speed = max(abs(float(found[3])), 0.3 * size)
    return float(found[4]) / speed, noise * float(np.sqrt(variance[4])) / speed


def gained(rows: Array, at: float) -> float:
    """Speed that a body gained at a time [m/s]."""
    after = rows[rows[:, 0] > at + 0.4]
    return abs(speed_of(after) - speed_of(rows[rows[:, 0] < at]))
