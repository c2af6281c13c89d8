import math
from typing import NamedTuple

import numpy as np
import pytest
from scipy.integrate import DOP853

from sim_twin.orbit import dop853, fixed, smooth
from sim_twin.orbit.system import (
    compiled_derivative,
    compiled_input,
    control_of,
    derivative_of,
    input_of,
)


class Arenstorf(NamedTuple):
    """Restricted three-body problem; Hairer, Norsett, Wanner, section II.0: a hard test."""

    mu: float


@compiled_input(Arenstorf)
def nothing(system, t, y, u):
    u[:] = 0.0


@compiled_derivative(Arenstorf)
def three_bodies(system, t, y, u, rate):
    mu, nu = system.mu, 1.0 - system.mu
    d1 = ((y[0] + mu) ** 2 + y[1] ** 2) ** 1.5
    d2 = ((y[0] - nu) ** 2 + y[1] ** 2) ** 1.5
    rate[0], rate[1] = y[2], y[3]
    rate[2] = y[0] + 2.0 * y[3] - nu * (y[0] + mu) / d1 - mu * (y[0] - nu) / d2
    rate[3] = y[1] - 2.0 * y[2] - nu * y[1] / d1 - mu * y[1] / d2


class Swing(NamedTuple):
    """y'' = u, u = -w^2 y held or not; the third state sums up |u|."""

    w2: float


@compiled_input(Swing)
def spring(system, t, y, u):
    u[0] = -system.w2 * y[0]


@compiled_derivative(Swing)
def swing(system, t, y, u, rate):
    rate[0], rate[1], rate[2] = y[1], u[0], abs(u[0])


class Switch(NamedTuple):
    """y'' = -sgn(y'): Coulomb friction, which no step control likes."""

    friction: float


@compiled_input(Switch)
def friction(system, t, y, u):
    u[0] = -system.friction * np.sign(y[1])


@compiled_derivative(Switch)
def slide(system, t, y, u, rate):
    rate[0], rate[1] = y[1], u[0]


class Blowup(NamedTuple):
    """y' = y^2: infinite at t = 1 from y = 1."""

    unused: float = 0.0


@compiled_input(Blowup)
def no_input(system, t, y, u):
    u[:] = 0.0


@compiled_derivative(Blowup)
def square(system, t, y, u, rate):
    rate[0] = y[0] * y[0]


MOON = Arenstorf(0.012277471)
START = np.array([0.994, 0.0, 0.0, -2.00158510637908252240537862224])
PERIOD = 17.0652165601579625588917206249


def scipy_steps(rtol, atol):
    """scipy's own steps: final state, accepted steps, evaluations."""

    def rate(t, y):
        out = np.empty(4)
        three_bodies(MOON, t, y, np.zeros(1), out)
        return out

    solver, steps = DOP853(rate, 0.0, START, PERIOD, rtol=rtol, atol=atol), 0
    while solver.status == "running":
        solver.step()
        steps += 1
    return solver.y, steps, solver.nfev


@pytest.mark.parametrize("rtol", [1e-4, 1e-8, 1e-12])
def test_compiled_dop853_takes_scipys_steps(rtol):
    y, steps, evaluations = scipy_steps(rtol, rtol)
    ours = dop853.solve(MOON, START, (0.0, PERIOD), rtol=rtol, atol=rtol, inputs=1)
    assert (ours.steps, ours.evaluations) == (steps, evaluations)
    # rounding grows along an orbit that passes the Moon this close
    assert ours.y[-1] == pytest.approx(y, abs=1e-6)


def test_arenstorfs_orbit_closes():
    ours = dop853.solve(MOON, START, (0.0, PERIOD), rtol=1e-13, atol=1e-13, inputs=1)
    assert ours.y[-1] == pytest.approx(START, abs=3e-6)
    assert ours.rejected > 0


def test_sample_times_are_hit_and_do_not_hold_back_the_step():
    times = np.linspace(0.0, 10.0, 41)
    sampled = dop853.solve(Swing(1.0), [1.0, 0.0, 0.0], times, rtol=1e-9, atol=1e-9, inputs=1)
    assert sampled.y[:, 0] == pytest.approx(np.cos(times), abs=1e-8)
    assert sampled.steps <= 80
    coarse = dop853.solve(Swing(1.0), [1.0, 0.0, 0.0], (0.0, 10.0), rtol=1e-9, atol=1e-9, inputs=1)
    one_more = dop853.solve(
        Swing(1.0), [1.0, 0.0, 0.0], (0.0, 1e-3, 10.0), rtol=1e-9, atol=1e-9, inputs=1
    )
    assert one_more.steps <= coarse.steps + 5  # it starts with 1 ms and grows tenfold


def test_a_component_without_a_tolerance_has_no_say():
    start, times = [1.0, 0.0, 0.0], (0.0, 8 * math.pi)
    smooth_only = [1e-10, 1e-10, np.inf]
    free = dop853.solve(Swing(1.0), start, times, rtol=1e-10, atol=smooth_only, inputs=1)
    held = dop853.solve(Swing(1.0), start, times, rtol=1e-10, atol=1e-10, inputs=1)
    assert held.rejected > 2 * free.rejected  # |u| has corners
    assert free.steps < held.steps
    assert free.y[-1, 2] == pytest.approx(16.0, rel=2e-2)  # integral of |cos| over 4 turns
    assert free.y[-1, :2] == pytest.approx([1.0, 0.0], abs=1e-8)


@pytest.mark.parametrize(("method", "order"), [(False, 4), (True, 1)], ids=["rk4", "hold"])
def test_order_of_the_fixed_step(method, order):
    def error(steps):
        y = fixed.solve(
            Swing(1.0), [1.0, 0.0, 0.0],
            start=0.0, step=5.0 / steps, steps=steps, every=steps, hold=method, inputs=1,
        )  # fmt: skip
        return abs(y[-1, 0] - math.cos(5.0))

    measured = math.log2(error(200) / error(400))
    assert measured == pytest.approx(order, abs=0.15)


def test_held_input_is_exact_for_a_double_integrator():
    h, y = 0.1, np.array([1.0, 0.0])
    found = fixed.solve(
        Swing(1.0), [*y, 0.0], start=0.0, step=h, steps=30, every=1, hold=True, inputs=1
    )
    for k in range(30):
        u = -y[0]
        y = np.array([y[0] + h * y[1] + 0.5 * h * h * u, y[1] + h * u])
        assert found[k + 1, :2] == pytest.approx(y, rel=1e-13)


def test_friction_stops_the_slide_within_a_step():
    step = 1e-3
    y = fixed.solve(
        Switch(0.5), [0.0, 1.0], start=0.0, step=step, steps=4000, every=4000, hold=True, inputs=1
    )
    assert abs(y[-1, 1]) <= 0.5 * step + 1e-12
    assert y[-1, 0] == pytest.approx(1.0, abs=2e-3)  # v^2 / (2 a)


def test_samples_of_the_fixed_step_are_every_so_many():
    kept = fixed.solve(
        Swing(1.0), [1.0, 0.0, 0.0], start=0.0, step=0.01, steps=60, every=20, hold=False, inputs=1
    )
    all_of_them = fixed.solve(
        Swing(1.0), [1.0, 0.0, 0.0], start=0.0, step=0.01, steps=60, hold=False, inputs=1
    )
    assert kept.tolist() == all_of_them[::20].tolist()


def test_a_system_that_blows_up_is_said_so():
    with pytest.raises(RuntimeError, match=r"stopped at t = 1 s of 2 s: the step became too small"):
        dop853.solve(Blowup(), [1.0], (0.0, 2.0), rtol=1e-8, atol=1e-8, inputs=1)
    with pytest.raises(RuntimeError, match="5 steps taken"):
        dop853.solve(MOON, START, (0.0, PERIOD), rtol=1e-8, atol=1e-8, inputs=1, max_steps=5)
    with (
        pytest.raises(RuntimeError, match="integration stopped at t = "),
        np.errstate(all="ignore"),
    ):
        smooth.solve(lambda t, y: y * y, [1.0], (0.0, 2.0))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"times": (0.0,)}, "two or more increasing times"),
        ({"times": (0.0, 1.0, 1.0)}, "two or more increasing times"),
        ({"y0": [[1.0, 0.0]]}, "expected a finite state"),
        ({"y0": [np.nan, 0.0, 0.0]}, "expected a finite state"),
        ({"rtol": 0.0}, "rtol > 0"),
        ({"atol": -1.0}, "atol >= 0"),
    ],
)
def test_nonsense_is_refused_by_the_adaptive_one(changes, message):
    arguments = {"y0": [1.0, 0.0, 0.0], "times": (0.0, 1.0), "rtol": 1e-8, "atol": 1e-8}
    with pytest.raises(ValueError, match=message):
        dop853.solve(Swing(1.0), inputs=1, **(arguments | changes))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"step": 0.0}, "step > 0"),
        ({"every": 3}, "divisible by `every`"),
        ({"y0": [np.inf, 0.0, 0.0]}, "expected a finite state"),
    ],
)
def test_nonsense_is_refused_by_the_fixed_one(changes, message):
    arguments = {"y0": [1.0, 0.0, 0.0], "step": 0.1, "steps": 10, "every": 2}
    with pytest.raises(ValueError, match=message):
        fixed.solve(Swing(1.0), start=0.0, hold=False, inputs=1, **(arguments | changes))


def test_plain_python_is_told_that_this_is_compiled_code():
    with pytest.raises(TypeError, match="no compiled input for int"):
        input_of(3, 0.0, None, None)
    with pytest.raises(TypeError, match="no compiled derivative for int"):
        derivative_of(3, 0.0, None, None, None)
    with pytest.raises(TypeError, match="no compiled control int"):
        control_of(3, 0.0, None, None, None)
