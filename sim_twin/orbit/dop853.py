r"""Compiled Runge-Kutta of order 8 with step control, for systems of `sim_twin.orbit.system`.

Source: E. Hairer, S. P. Norsett, G. Wanner, "Solving Ordinary Differential Equations I", 2nd ed.,
1993, section II.5 and II.4 (first step); the coefficients are those of `scipy.integrate.DOP853`,
and so is the step control: between the same two times both take the same steps.

Differences from scipy: steps are shortened to end at the sample times instead of interpolating, and
the absolute tolerance is given per component; components with `atol = inf` are excluded from the
step control (integrals of |u|, which are not smooth).
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import DOP853

from sim_twin.orbit.system import Integrator, derivative_of, generic, input_of
from testbed.core.compiled import compiled

Array = NDArray[np.float64]

STAGES = 12
A = np.ascontiguousarray(DOP853.A[:STAGES, :STAGES])
B = np.ascontiguousarray(DOP853.B)
C = np.ascontiguousarray(DOP853.C[:STAGES])
E3 = np.ascontiguousarray(DOP853.E3)
E5 = np.ascontiguousarray(DOP853.E5)
EXPONENT = -1.0 / 8.0
SAFETY, SHRINK, GROW = 0.9, 0.2, 10.0
DONE, STUCK, TIRED = range(3)


class Solution(NamedTuple):
    """Samples of the state and the cost of the integration."""

    y: Array  # (m, n) at the m requested times
    steps: int
    rejected: int
    evaluations: int


def solve(
    system: Any, y0: ArrayLike, times: ArrayLike, *,
    rtol: float, atol: ArrayLike, inputs: int, max_steps: int = 10_000_000,
) -> Solution:  # fmt: skip
    """Integrate a compiled system.

    Args:
        system: a named tuple with compiled input and derivative.
        y0: state at `times[0]`, shape (n,).
        times: increasing, at least two [s].
        rtol: relative tolerance per step.
        atol: absolute tolerance per step, a number or one per component, in the state's units.
        inputs: size of the system's input.
        max_steps: limit of accepted and rejected steps together.

    Raises:
        ValueError: invalid initial state, times or tolerances.
        RuntimeError: the step became too small, or there were too many.
    """
    start = np.array(y0, dtype=float)
    at = np.array(times, dtype=float)
    if start.ndim != 1 or not np.all(np.isfinite(start)):
        raise ValueError(f"expected a finite state of shape (n,), found shape {start.shape}")
    if at.ndim != 1 or at.size < 2 or not np.all(np.diff(at) > 0.0):
        raise ValueError("expected two or more increasing times [s]")
    tolerance = np.ascontiguousarray(np.broadcast_to(np.asarray(atol, dtype=float), start.shape))
    if not rtol > 0.0 or not np.all(tolerance >= 0.0):
        raise ValueError(f"expected rtol > 0 and atol >= 0, found rtol = {rtol}")
    y, counts, t, state = run(system, start, at, rtol, tolerance, inputs, max_steps)
    if state != DONE:
        cause = "the step became too small" if state == STUCK else f"{max_steps} steps taken"
        raise RuntimeError(
            f"integration stopped at t = {t:.6g} s of {at[-1]:.6g} s: {cause}; "
            "check for forces that are infinite or too discontinuous for step size control"
        )
    return Solution(y, int(counts[0]), int(counts[1]), int(counts[2]))


@compiled
def size(y, scale, counted):
    """Root mean square of y / scale over the components selected by `counted`."""
    total = 0.0
    for k in range(y.shape[0]):
        total += (y[k] / scale[k]) ** 2
    return np.sqrt(total / counted)


@compiled
def copy(x, out):
    """Copy x to `out`; a loop compiles faster than `out[:] = x`, which checks shapes."""
    for k in range(x.shape[0]):
        out[k] = x[k]


@generic
def rate_at(system, t, y, u, out):
    """The derivative, with the input evaluated at the same time."""
    input_of(system, t, y, u)
    derivative_of(system, t, y, u, out)


@generic
def first_step(system, t, y, f, span, rtol, atol, counted, u):
    """Initial step size by Hairer's estimate [s]."""
    scale = atol + np.abs(y) * rtol
    d0, d1 = size(y, scale, counted), size(f, scale, counted)
    h0 = 1e-6 if d0 < 1e-5 or d1 < 1e-5 else 0.01 * d0 / d1
    h0 = min(h0, span)
    f1 = np.empty_like(y)
    rate_at(system, t + h0, y + h0 * f, u, f1)
    d2 = size(f1 - f, scale, counted) / h0
    if d1 <= 1e-15 and d2 <= 1e-15:
        h1 = max(1e-6, h0 * 1e-3)
    else:
        h1 = (0.01 / max(d1, d2)) ** (1.0 / 8.0)
    return min(100.0 * h0, h1, span)


@generic
def attempt(system, t, y, h, k, u, new, rtol, atol, counted):
    """One step into `new`; k[0] is the derivative at `y`, k[12] becomes the one at `new`.

    Returns:
        the error relative to the tolerance.
    """
    n = y.shape[0]
    for s in range(1, STAGES):
        copy(y, new)
        for j in range(s):
            if A[s, j] != 0.0:
                weight = h * A[s, j]
                for i in range(n):
                    new[i] += weight * k[j, i]
        rate_at(system, t + C[s] * h, new, u, k[s])
    copy(y, new)
    for j in range(STAGES):
        if B[j] != 0.0:
            weight = h * B[j]
            for i in range(n):
                new[i] += weight * k[j, i]
    rate_at(system, t + h, new, u, k[STAGES])
    five, three = 0.0, 0.0
    for i in range(n):
        e5, e3 = 0.0, 0.0
        for j in range(STAGES + 1):
            e5 += E5[j] * k[j, i]
            e3 += E3[j] * k[j, i]
        scale = atol[i] + max(abs(y[i]), abs(new[i])) * rtol
        five += (e5 / scale) ** 2
        three += (e3 / scale) ** 2
    if five == 0.0 and three == 0.0:
        return 0.0
    return h * five / np.sqrt((five + 0.01 * three) * counted)


@Integrator
def run(system, y0, times, rtol, atol, inputs, max_steps):
    """See `solve`; returns samples, (steps, rejected, evaluations), time reached, exit state."""
    n = y0.shape[0]
    u, k, new = np.zeros(inputs), np.empty((STAGES + 1, n)), np.empty(n)
    samples = np.full((times.shape[0], n), np.nan)
    counts = np.zeros(3, dtype=np.int64)
    counted = max(1, np.sum(np.isfinite(atol)))
    t, y = times[0], y0.copy()
    copy(y, samples[0])
    rate_at(system, t, y, u, k[0])
    h = first_step(system, t, y, k[0], times[-1] - t, rtol, atol, counted, u)
    counts[2] = 2
    for m in range(1, times.shape[0]):
        while t < times[m]:
            fell = False
            while True:
                if counts[0] + counts[1] >= max_steps:
                    return samples, counts, t, TIRED
                last = t + h >= times[m]
                step = times[m] - t if last else h
                if not step > 10.0 * abs(np.nextafter(t, np.inf) - t) and not last:
                    return samples, counts, t, STUCK
                error = attempt(system, t, y, step, k, u, new, rtol, atol, counted)
                counts[2] += STAGES
                if error < 1.0:
                    break
                counts[1] += 1
                fell = True
                h = step * (max(SHRINK, SAFETY * error**EXPONENT) if np.isfinite(error) else SHRINK)
                if t + h == t:
                    return samples, counts, t, STUCK
            grow = GROW if error == 0.0 else min(GROW, SAFETY * error**EXPONENT)
            if fell:
                grow = min(1.0, grow)
            h = max(h, step * grow) if last and not fell else step * grow
            t = times[m] if last else t + step
            copy(new, y)
            copy(k[STAGES], k[0])
            counts[0] += 1
        copy(y, samples[m])
    return samples, counts, t, DONE
