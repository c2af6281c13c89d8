"""Linear-quadratic regulation to a goal without obstacle avoidance: the best linear law.

Source: B. D. O. Anderson, J. B. Moore, "Optimal Control: Linear Quadratic Methods", Prentice-Hall,
1990, chapter 2; weights by A. E. Bryson, Y.-C. Ho, "Applied Optimal Control", 1975, section 5.2.

    minimise sum over jet periods of |e|^2/error^2 + |e'|^2/speed^2 + |a|^2/accel^2

    textbook    code             meaning                                              unit
    K           feedback         a = -K (e, e'), discrete, for the period it is held  1/s^2, 1/s
    Q, R        error, speed, accel  acceptable values x; weights are 1/x^2           m, m/s, m/s^2
    n           mean_motion      of the orbit, with feed = "orbit"                    rad/s

`feed` selects the compensation of the acceleration without thrust: "disturbance" cancels
own.disturbance; "orbit" uses the Clohessy-Wiltshire equations as the model, for a goal anywhere in
the frame; "none" leaves it to the feedback. The gain is designed for the jet period, during which
the force is held.

The force is limited to own.max_force, direction kept; the cost does not include this limit.
"""

from typing import Literal

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from controllers.sampled import Sampled, feedback, generator, sampled, weights
from controllers.scale import Scale
from testbed.core.error import MismatchError
from testbed.core.law import Body, Concern, Law, Neighbours, World, bounded
from testbed.core.vehicle import NonNegative, Positive

Array = NDArray[np.float64]
Feed = Literal["disturbance", "orbit", "none"]


def check_orbit(feed: Feed, mean_motion: float) -> None:
    """Raise unless a mean motion is given exactly with feed = "orbit"."""
    if (feed == "orbit") != (mean_motion > 0.0):
        raise MismatchError(
            'mean_motion > 0 with feed = "orbit" and 0 otherwise',
            f'{mean_motion:g} rad/s with feed = "{feed}"',
        )


class LqrParams(Struct, frozen=True, forbid_unknown_fields=True, tag="lqr"):
    """Acceptable values for Bryson's rule, and the model."""

    error: Positive = 1.0  # [m]
    speed: Positive = 0.1  # [m/s]
    accel: Positive = 0.02  # [m/s^2]
    feed: Feed = "disturbance"
    mean_motion: NonNegative = 0.0  # [rad/s]
    period: Positive = 0.1  # hold time of a force if the caller does not give one [s]
    scale: Scale = field(default_factory=Scale)

    def __post_init__(self) -> None:
        check_orbit(self.feed, self.mean_motion)


def steady(generator: Array, state: Array, accel: Array, disturbance: Array, feed: Feed) -> Array:
    """The acceleration that keeps a satellite on its goal, shape (..., d) [m/s^2].

    Args:
        generator: of the model, (2d, 2d).
        state: of the goal, (..., 2d).
        accel: of the goal, (..., d) [m/s^2].
        disturbance: acceleration of the satellite without thrust, (d,) [m/s^2].
        feed: compensation of the disturbance, see above.
    """
    a = accel - state @ generator[disturbance.shape[0] :].T
    return a - disturbance if feed == "disturbance" else a


class Lqr:
    """The linear-quadratic regulator; it has no state."""

    def __init__(self, params: LqrParams, d: int) -> None:
        self._params, self._d = params, d
        self._generator = generator(params.mean_motion, d)[0]
        self._gains: dict[float, Array] = {}

    def gain(self, period: float) -> Array:
        """K, shape (d, 2d), for a force that is held for `period` [s]."""
        if period not in self._gains:
            p = self._params
            cost = weights(p.error, p.speed, p.accel, self._d)
            self._gains[period] = feedback(sampled(p.mean_motion, self._d, period), cost)
        return self._gains[period]

    def initial(self, own: Body, neighbours: Neighbours, world: World) -> Array:
        """See `Law`."""
        return np.zeros(0)

    def decide(
        self, law_state: Array, own: Body, neighbours: Neighbours, world: World, duration: float
    ) -> tuple[Array, Array]:
        """See `Decider`."""
        goal = np.concatenate((world.goal.p, world.goal.v))
        off = np.concatenate((own.p, own.v)) - goal
        a = steady(self._generator, goal, world.goal.a, own.disturbance, self._params.feed)
        a -= self.gain(duration) @ off
        return bounded(own.mass * a, own.max_force), law_state

    def concerns(self, law_state: Array) -> list[Concern]:
        """See `Decider`."""
        return []


def lqr(params: LqrParams, d: int) -> Law:
    """The law for positions of shape (d,)."""
    return Sampled(Lqr(params, d), params.period)
