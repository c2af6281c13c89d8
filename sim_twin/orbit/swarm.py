r"""Many satellites at once under a common control: in ECI with J2, or relative to a chief.

State of `Swarm` (ECI): r (n + 1, 3) [m], v (n + 1, 3) [m/s], spent (n, 3) [m/s], flattened in that
order. The first r and v are those of the formation's centre, a satellite that is not controlled.
State of `Deputies` (radial frame of a chief on Kepler's orbit): p (n, 3), v (n, 3), spent (n, 3).
The control gets positions and velocities in the relative frame and returns accelerations in it,
which are limited on each axis; `spent` integrates their absolute values.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_twin.orbit import dop853
from sim_twin.orbit.frames import moving, to_eci, to_relative, turned_to_eci
from sim_twin.orbit.gravity import EARTH, Planet, pull, pull_all
from sim_twin.orbit.relative import Chief, drift, frame_at
from sim_twin.orbit.system import (
    clip_each,
    compiled_derivative,
    compiled_input,
    control_of,
)
from testbed.core.compiled import borrowed, compiled

Array = NDArray[np.float64]


class Swarm(NamedTuple):
    """Satellites in ECI around an uncontrolled centre."""

    control: NamedTuple  # a type with a compiled control
    planet: Planet
    axes: Array  # the control's frame: frames.RADIAL, frames.NADIR, ...
    limit: float  # of the acceleration on each axis of that frame [m/s^2]


class Deputies(NamedTuple):
    """Satellites in the radial frame of a chief."""

    control: NamedTuple
    chief: Chief
    limit: float  # [m/s^2]


class Flight(NamedTuple):
    """Trajectory of a swarm at m times."""

    r: Array  # (m, n, 3) in ECI [m]
    v: Array  # (m, n, 3) [m/s]
    p: Array  # (m, n, 3) in the control's frame [m]
    q: Array  # (m, n, 3) velocity in the control's frame [m/s]
    spent: Array  # (m, n, 3) integral of |u| per axis of that frame [m/s]
    centre: Array  # (m, 6) position and velocity of the centre in ECI
    steps: int
    evaluations: int


@compiled
def centre_frame(planet, r, v, axes):
    """The frame of the centre, which is the first satellite."""
    a = np.empty(3)
    a[0], a[1], a[2] = pull(planet, r[0, 0], r[0, 1], r[0, 2])
    return moving(r[0], v[0], a, axes)


@compiled_input(Swarm)
def ask(system, t, y, u):
    """Write the control's accelerations, in the control's frame."""
    system, y, u = borrowed((system, y, u))
    n = u.shape[0] // 3
    m = 3 * (n + 1)
    r, v = y[:m].reshape(n + 1, 3), y[m : 2 * m].reshape(n + 1, 3)
    p, q = np.empty((n, 3)), np.empty((n, 3))
    to_relative(centre_frame(system.planet, r, v, system.axes), r[1:], v[1:], p, q)
    control_of(system.control, t, p, q, u.reshape(n, 3))
    clip_each(u, system.limit)


@compiled_derivative(Swarm)
def move(system, t, y, u, rate):
    """Write the state's derivative: gravity and thrust."""
    system, y, u, rate = borrowed((system, y, u, rate))
    n = u.shape[0] // 3
    m = 3 * (n + 1)
    r, v = y[:m].reshape(n + 1, 3), y[m : 2 * m].reshape(n + 1, 3)
    a, thrust = rate[m : 2 * m].reshape(n + 1, 3), np.empty((n, 3))
    frame = centre_frame(system.planet, r, v, system.axes)
    turned_to_eci(frame, u.reshape(n, 3), thrust)
    pull_all(system.planet, r, a)
    for i in range(n):
        for k in range(3):
            a[i + 1, k] += thrust[i, k]
    for k in range(m):  # loops: `rate[:m] = ...` takes seconds to compile
        rate[k] = y[m + k]
    for k in range(u.shape[0]):
        rate[2 * m + k] = abs(u[k])


@compiled_input(Deputies)
def ask_deputies(system, t, y, u):
    """Write the control's accelerations, in the chief's frame."""
    n = u.shape[0] // 3
    p, v = y[: 3 * n].reshape(n, 3), y[3 * n : 6 * n].reshape(n, 3)
    control_of(system.control, t, p, v, u.reshape(n, 3))
    clip_each(u, system.limit)


@compiled_derivative(Deputies)
def move_deputies(system, t, y, u, rate):
    """Write the state's derivative: relative motion and thrust."""
    n = u.shape[0] // 3
    p, v = y[: 3 * n].reshape(n, 3), y[3 * n : 6 * n].reshape(n, 3)
    frame = frame_at(system.chief, t)
    for i in range(n):
        a = drift(frame, p[i], v[i])
        for k in range(3):
            rate[3 * (n + i) + k] = a[k] + u[3 * i + k]
    for k in range(3 * n):
        rate[k] = y[3 * n + k]
        rate[6 * n + k] = abs(u[k])


def fly(
    control: NamedTuple, centre: ArrayLike, p: ArrayLike, q: ArrayLike, times: ArrayLike, *,
    axes: Array, planet: Planet = EARTH, limit: float = np.inf,
    rtol: float = 1e-10, atol: float = 1e-6,
) -> Flight:  # fmt: skip
    """Integrate satellites in ECI from initial states in the centre's frame.

    Args:
        control: a named tuple with a compiled control; `Coast()` for none.
        centre: position [m] and velocity [m/s] of the centre in ECI, shape (6,).
        p: positions in the centre's frame at `times[0]`, shape (n, 3) [m].
        q: velocities in the centre's frame, shape (n, 3) [m/s].
        times: increasing, at least two [s].
        axes: the frame's axes: `frames.RADIAL`, `frames.NADIR`, ...
        planet: gravity model.
        limit: of the acceleration on each axis of the frame [m/s^2].
        rtol: relative tolerance per step.
        atol: absolute tolerance per step, in m; a thousandth of it in m/s.

    Raises:
        ValueError: wrong shapes.
        RuntimeError: the integration stopped early.
    """
    hub, p, q = np.array(centre, dtype=float), np.array(p, dtype=float), np.array(q, dtype=float)
    if hub.shape != (6,) or p.ndim != 2 or p.shape[1] != 3 or q.shape != p.shape:
        raise ValueError(
            "expected a centre of shape (6,), positions and velocities of shape (n, 3), "
            f"found {hub.shape}, {p.shape}, {q.shape}"
        )
    n = len(p)
    r, v = np.empty((n + 1, 3)), np.empty((n + 1, 3))
    r[0], v[0] = hub[:3], hub[3:]
    to_eci(centre_frame(planet, r, v, axes), p, q, r[1:], v[1:])
    start = np.concatenate([r.ravel(), v.ravel(), np.zeros(3 * n)])
    tolerance = np.repeat([atol, 1e-3 * atol, np.inf], [3 * n + 3, 3 * n + 3, 3 * n])
    found = dop853.solve(
        Swarm(control, planet, axes, limit), start, times,
        rtol=rtol, atol=tolerance, inputs=3 * n,
    )  # fmt: skip
    return _flight(found, planet, axes, n)


def _flight(found: dop853.Solution, planet: Planet, axes: Array, n: int) -> Flight:
    m = len(found.y)
    r = found.y[:, : 3 * n + 3].reshape(m, n + 1, 3)
    v = found.y[:, 3 * n + 3 : 6 * n + 6].reshape(m, n + 1, 3)
    p, q = np.empty((m, n, 3)), np.empty((m, n, 3))
    for k in range(m):
        to_relative(centre_frame(planet, r[k], v[k], axes), r[k, 1:], v[k, 1:], p[k], q[k])
    return Flight(
        r[:, 1:], v[:, 1:], p, q, found.y[:, 6 * n + 6 :].reshape(m, n, 3),
        np.concatenate([r[:, 0], v[:, 0]], axis=1), found.steps, found.evaluations,
    )  # fmt: skip
