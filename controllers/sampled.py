"""Laws that decide once per jet period and hold their force until the next, and their linear model.

    x_{k+1} = A x_k + B a_k,  x = (position, velocity), shape (2d,), a: acceleration, shape (d,)

The model is the double integrator or, with a `mean_motion` n, the Clohessy-Wiltshire equations with
x radial, y along the orbit, z along its normal:

    x'' = 3 n^2 x + 2 n y' + a_x        y'' = -2 n x' + a_y        z'' = -n^2 z + a_z
"""

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from testbed.core.law import Ahead, Body, Concern, Neighbours, World

Array = NDArray[np.float64]


class DiscreteModel(NamedTuple):
    """The discrete linear model of a satellite."""

    a: Array  # (2d, 2d)
    b: Array  # (2d, d)


class Weights(NamedTuple):
    """Weights of the quadratic cost by Bryson's rule: 1 over the square of the acceptable value."""

    state: Array  # (2d, 2d)
    accel: Array  # (d, d)


def weights(error: float, speed: float, accel: float, d: int) -> Weights:
    """Weights from acceptable error [m], speed [m/s] and acceleration [m/s^2]."""
    state = np.repeat([error**-2, speed**-2], d)
    return Weights(np.diag(state), np.eye(d) * accel**-2)


def generator(mean_motion: float, d: int) -> tuple[Array, Array]:
    """Matrices F (2d, 2d) and G (2d, d) of the continuous model x' = F x + G a."""
    n = mean_motion
    f, g = np.zeros((2 * d, 2 * d)), np.zeros((2 * d, d))
    f[:d, d:], g[d:] = np.eye(d), np.eye(d)
    if n > 0.0:
        tide = np.array([3.0 * n * n, 0.0, -n * n])
        f[d:, :d] = np.diag(tide[:d])
        f[d, d + 1], f[d + 1, d] = 2.0 * n, -2.0 * n
    return f, g


def sampled(mean_motion: float, d: int, step: float) -> DiscreteModel:
    """Exact discrete model over `step` [s] under constant acceleration."""
    from scipy.linalg import expm  # takes a third of a second to import

    f, g = generator(mean_motion, d)
    whole = np.zeros((3 * d, 3 * d))
    whole[: 2 * d, : 2 * d], whole[: 2 * d, 2 * d :] = f, g
    both = expm(whole * step)
    return DiscreteModel(both[: 2 * d, : 2 * d], both[: 2 * d, 2 * d :])


def cost_to_go(model: DiscreteModel, cost: Weights) -> Array:
    """Solution P of the discrete Riccati equation, (2d, 2d): x'P x is the least cost from x on."""
    from scipy.linalg import solve_discrete_are

    return solve_discrete_are(model.a, model.b, cost.state, cost.accel)


def feedback(model: DiscreteModel, cost: Weights) -> Array:
    """K of the optimal a = -K x, shape (d, 2d)."""
    p, b = cost_to_go(model, cost), model.b
    gain = np.linalg.solve(cost.accel + b.T @ p @ b, b.T @ p @ model.a)
    return np.asarray(gain, dtype=np.float64)


class Decider(Protocol):
    """The part of a sampled law that decides the force."""

    def initial(self, own: Body, neighbours: Neighbours, world: World) -> Array:
        """The law's state at the start, shape (n,)."""
        ...

    def decide(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World, duration: float
    ) -> tuple[Array, Array]:
        """Force (d,) [N] for the next `duration` [s], and the law's state at its end."""
        ...

    def concerns(self, law_state: Array) -> list[Concern]:
        """Concerns that the operator should know, from the law's state."""
        ...


class Sampled:
    """A `Law` that holds the force of its last decision."""

    message_size = 0

    def __init__(self, decider: Decider, period: float) -> None:
        """`period` is the hold time assumed in `rate`, which gets none [s]."""
        self._decider, self._period = decider, period
        self.initial = decider.initial
        self.concerns = decider.concerns

    def rate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World, t: float
    ) -> tuple[Array, Array]:
        """See `Law`; the force of a decision at this time."""
        force, _ = self._decider.decide(law_state, own, neighbours, world, self._period)
        return force, np.zeros_like(law_state)

    def propagate(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World,
        t: float, duration: float, steps: int,
    ) -> Ahead:  # fmt: skip
        """See `Law`; exact for a constant force, independent of `steps`."""
        force, state = self._decider.decide(law_state, own, neighbours, world, duration)
        h, a = duration, force / own.mass + own.disturbance
        p = own.p + h * own.v + h**2 / 2.0 * a + h**3 / 6.0 * own.disturbance_rate
        v = own.v + h * a + h**2 / 2.0 * own.disturbance_rate
        return Ahead(state, p, v, force, np.zeros(0))
