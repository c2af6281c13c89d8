r"""Compiled Runge-Kutta of order 4 with a fixed step, for systems of `sim_twin.orbit.system`.

For laws with sgn, whose switching makes step size control fail. `hold = False` evaluates the input
in every stage; `hold = True` evaluates it once per step and holds it, like a sampled controller.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_twin.orbit.system import Integrator, derivative_of, generic, input_of

Array = NDArray[np.float64]


def solve(
    system: Any, y0: ArrayLike, *,
    start: float, step: float, steps: int, every: int = 1, hold: bool, inputs: int,
) -> Array:  # fmt: skip
    """Integrate a compiled system.

    Args:
        system: a named tuple with compiled input and derivative.
        y0: state at `start`, shape (n,).
        start: initial time [s].
        step: step size [s].
        steps: number of steps.
        every: keep every n-th state; must divide `steps`.
        hold: whether the input is held over a step.
        inputs: size of the system's input.

    Returns:
        the state at start, start + every * step, ..., shape (steps / every + 1, n).
    """
    y = np.array(y0, dtype=float)
    if y.ndim != 1 or not np.all(np.isfinite(y)):
        raise ValueError(f"expected a finite state of shape (n,), found shape {y.shape}")
    if not step > 0.0 or every < 1 or steps < 0 or steps % every:
        raise ValueError(
            f"expected step > 0 and a number of steps divisible by `every`, "
            f"found step = {step} s, steps = {steps}, every = {every}"
        )
    return run(system, y, float(start), float(step), steps, every, hold, inputs)


@generic
def stage(system, t, y, u, hold, rate):
    """Evaluate the derivative for one stage, and the input unless it is held."""
    if not hold:
        input_of(system, t, y, u)
    derivative_of(system, t, y, u, rate)


@Integrator
def run(system, y, start, h, steps, every, hold, inputs):
    """See `solve`."""
    n = y.shape[0]
    u = np.zeros(inputs)
    k1, k2, k3, k4, mid = np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    samples = np.empty((steps // every + 1, n))
    samples[0] = y
    for m in range(steps):
        t = start + m * h  # not accumulated, to avoid rounding drift
        if hold:
            input_of(system, t, y, u)
        stage(system, t, y, u, hold, k1)
        for i in range(n):
            mid[i] = y[i] + 0.5 * h * k1[i]
        stage(system, t + 0.5 * h, mid, u, hold, k2)
        for i in range(n):
            mid[i] = y[i] + 0.5 * h * k2[i]
        stage(system, t + 0.5 * h, mid, u, hold, k3)
        for i in range(n):
            mid[i] = y[i] + h * k3[i]
        stage(system, t + h, mid, u, hold, k4)
        for i in range(n):
            y[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])
        if (m + 1) % every == 0:
            samples[(m + 1) // every] = y
    return samples
