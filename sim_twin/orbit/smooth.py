"""Integrates smooth right-hand sides in plain Python with scipy's DOP853."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]

RTOL = 1e-11
ATOL = 1e-9  # in the state's units: nanometres and nanometres per second


def solve(
    rate: Callable[[float, Array], ArrayLike],
    y0: ArrayLike,
    times: ArrayLike,
    *,
    rtol: float = RTOL,
    atol: ArrayLike = ATOL,
) -> Array:
    """States at `times` (increasing, the first is the start) [s], shape (m, n).

    Raises:
        RuntimeError: scipy failed; a law with sgn needs a fixed step.
    """
    at = np.array(times, dtype=float)
    if at.ndim != 1 or at.size < 2 or not np.all(np.diff(at) > 0.0):
        raise ValueError("expected two or more increasing times [s]")
    found = solve_ivp(
        rate, (at[0], at[-1]), np.array(y0, dtype=float),
        method="DOP853", t_eval=at, rtol=rtol, atol=atol,
    )  # fmt: skip
    if not found.success:
        raise RuntimeError(f"integration stopped at t = {found.t[-1]:.6g} s: {found.message}")
    return np.ascontiguousarray(found.y.T)
