import math
import re
import runpy
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numba.core.caching import NullCache
from scipy.integrate import solve_ivp

from sim_twin.orbit import dop853, smooth
from sim_twin.orbit.frames import NADIR, RADIAL
from sim_twin.orbit.gravity import EARTH, POINT_EARTH
from sim_twin.orbit.kepler import Orbit
from sim_twin.orbit.relative import chief_on, drift, frame_at
from sim_twin.orbit.swarm import Deputies, Swarm, fly
from sim_twin.orbit.system import Coast, compiled_control, composition

ORBIT = Orbit(a=6978e3, e=0.0002, i=math.radians(98.0), node=0.4, perigee=1.1, theta=0.3)


class Push(NamedTuple):
    """A thrust that turns slowly and brakes."""

    size: float  # [m/s^2]
    damping: float  # [1/s]


@compiled_control(Push)
def push(control, t, p, v, u):
    for i in range(p.shape[0]):
        u[i, 0] = control.size * np.sin(0.004 * t + i) - control.damping * v[i, 0]
        u[i, 1] = control.size * np.cos(0.003 * t) - control.damping * v[i, 1]
        u[i, 2] = control.size * np.sin(0.002 * t + 1.0) - control.damping * v[i, 2]


def scene(n, seed=7):
    rng = np.random.default_rng(seed)
    return 300.0 * rng.normal(size=(n, 3)), 0.2 * rng.normal(size=(n, 3))


def test_uncontrolled_satellites_fly_as_scipy_flies_them():
    p, q = scene(4)
    flight = fly(Coast(), np.concatenate(ORBIT.eci()), p, q, (0.0, 1000.0, 2000.0), axes=NADIR)

    def rate(t, y):  # two-body + J2, written once more
        r2 = y[:3] @ y[:3]
        bulge = 1.5 * EARTH.j2 * EARTH.radius**2 / r2
        s2 = y[2] ** 2 / r2
        factor = 1.0 + bulge * (np.array([1.0, 1.0, 3.0]) - 5.0 * s2)
        return np.concatenate([y[3:], -EARTH.mu / r2**1.5 * factor * y[:3]])

    for k in range(4):
        start = np.concatenate([flight.r[0, k], flight.v[0, k]])
        found = solve_ivp(rate, (0.0, 2000.0), start, method="DOP853", rtol=1e-12, atol=1e-7)
        assert np.linalg.norm(found.y[:3, -1] - flight.r[-1, k]) < 1e-3
        assert np.linalg.norm(found.y[3:, -1] - flight.v[-1, k]) < 1e-6
    assert flight.spent[-1].tolist() == np.zeros((4, 3)).tolist()
    assert flight.p[0] == pytest.approx(p, abs=1e-7)
    assert flight.q[0] == pytest.approx(q, abs=1e-10)


def test_thrusting_in_eci_and_in_the_chiefs_frame_are_the_same():
    # one integrates the satellites about the Earth, the other their motion about the chief
    p, q = scene(3)
    control, times = Push(1e-3, 1e-4), np.linspace(0.0, 6000.0, 7)
    flight = fly(
        control, np.concatenate(ORBIT.eci()), p, q, times,
        axes=RADIAL, planet=POINT_EARTH, rtol=1e-13, atol=1e-8,
    )  # fmt: skip
    start = np.concatenate([p.ravel(), q.ravel(), np.zeros(9)])
    tolerance = np.repeat([1e-9, 1e-12, np.inf], 9)
    system = Deputies(control, chief_on(ORBIT), np.inf)
    found = dop853.solve(system, start, times, rtol=1e-12, atol=tolerance, inputs=9)
    assert np.abs(flight.p[-1]).max() > 1e3
    assert found.y[:, :9] == pytest.approx(flight.p.reshape(7, 9), abs=1e-5)
    assert found.y[:, 9:18] == pytest.approx(flight.q.reshape(7, 9), abs=1e-8)


@pytest.mark.parametrize(("limit", "tolerance"), [(1.0, 1e-6), (5e-4, 1e-3)])
def test_compiled_deputies_fly_as_scipys(limit, tolerance):
    # the bound makes corners, which cost both some digits
    p, q = scene(2)
    control, chief, times = Push(1e-3, 1e-4), chief_on(ORBIT), (0.0, 3000.0)

    def rate(t, y):
        p, v, u = y[:6].reshape(2, 3), y[6:].reshape(2, 3), np.empty((2, 3))
        push(control, t, p, v, u)
        u = np.clip(u, -limit, limit)
        a = [drift(frame_at(chief, t), p[k], v[k]) + u[k] for k in range(2)]
        return np.concatenate([v.ravel(), *a])

    start = np.concatenate([p.ravel(), q.ravel()])
    wanted = smooth.solve(rate, start, times, rtol=1e-10, atol=1e-9)
    found = dop853.solve(
        Deputies(control, chief, limit), np.concatenate([start, np.zeros(6)]), times,
        rtol=1e-10, atol=np.repeat([1e-9, 1e-9, np.inf], 6), inputs=6,
    )  # fmt: skip
    assert found.y[-1, :12] == pytest.approx(wanted[-1], rel=0.0, abs=tolerance)


def test_thrust_is_bounded_on_each_axis_and_summed_up():
    # a push far above the bound: every axis works at the bound all the time
    flight = fly(
        Push(0.0, -1e9), np.concatenate(ORBIT.eci()),
        np.zeros((2, 3)), np.full((2, 3), 0.01), (0.0, 10.0),
        axes=NADIR, limit=0.01,
    )  # fmt: skip
    assert flight.spent[-1] == pytest.approx(np.full((2, 3), 0.1))
    assert flight.q[-1] - flight.q[0] == pytest.approx(np.full((2, 3), 0.1), abs=2e-3)


def test_the_centre_is_not_pushed():
    p, q = scene(2)
    centre, times = np.concatenate(ORBIT.eci()), (0.0, 500.0)
    pushed = fly(Push(0.1, 0.0), centre, p, q, times, axes=NADIR)
    free = fly(Coast(), centre, p, q, times, axes=NADIR)
    assert pushed.centre[-1] == pytest.approx(free.centre[-1], abs=1e-5)


def test_axes_name_the_same_motion():
    p, q = scene(3)
    centre, times = np.concatenate(ORBIT.eci()), (0.0, 700.0)
    radial = fly(Coast(), centre, p, q, times, axes=RADIAL)
    nadir = fly(Coast(), centre, p @ NADIR.T, q @ NADIR.T, times, axes=NADIR)
    assert nadir.p[-1] == pytest.approx(radial.p[-1] @ NADIR.T, abs=1e-6)
    assert nadir.q[-1] == pytest.approx(radial.q[-1] @ NADIR.T, abs=1e-9)


@pytest.mark.parametrize(
    ("centre", "p", "q"),
    [(5, (2, 3), (2, 3)), (6, (2, 2), (2, 2)), (6, (2, 3), (3, 3)), (6, (3,), (3,))],
)
def test_shapes_that_do_not_fit_are_refused(centre, p, q):
    with pytest.raises(ValueError, match="expected a centre of shape"):
        fly(Coast(), np.ones(centre), np.zeros(p), np.zeros(q), (0.0, 1.0), axes=NADIR)


def test_what_is_compiled_for_a_foreign_control_is_not_kept_on_disk():
    # their file may change without numba noticing, and be unknown to the next process
    def kept(control):
        parts = tuple(composition(Swarm(control, EARTH, NADIR, 1.0)))
        return not isinstance(dop853.run.version(parts)._cache, NullCache)

    assert kept(Coast())
    assert not kept(Push(1.0, 1.0))


def test_the_control_of_the_page_flies_as_typed(tmp_path):
    page = Path(__file__).parents[2] / "docs" / "orbit.md"
    (code,) = re.findall(r"^```python\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)
    (tmp_path / "own.py").write_text(code)
    flight = runpy.run_path(str(tmp_path / "own.py"))["flight"]
    assert flight.p.shape == (101, 2, 3)
    assert np.linalg.norm(flight.q[-1], axis=1).max() < 0.02  # braked from 0.2 m/s
    assert (flight.spent[-1] > 0.0).any(axis=1).all()
