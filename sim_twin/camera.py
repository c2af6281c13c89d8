"""Motion capture model: turns true states into delayed, noisy poses."""

from bisect import bisect_right
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_twin.randomness import Draws
from testbed.core.compiled import compiled, settled
from testbed.core.se2 import wrap_compiled
from testbed.core.table import Mocap
from testbed.core.types import PoseSample

Array = NDArray[np.float64]


class Optics(NamedTuple):
    """Parameters of the camera system for compiled code."""

    noise: float  # [m]
    spin_noise: float  # [rad]
    latency: float  # [s]
    jitter: float  # [s]
    losing: float  # probability that a loss begins, per frame
    lost: float  # mean length of a loss [s]


@compiled
def photograph(times, states, noise, luck, optics, lost_until):
    """Measure the pose of one body at each exposure.

    Args:
        times: of the exposures, shape (n,) [s].
        states: true x, y, theta, ... at these times, shape (n, 6).
        noise: standard normal, shape (n, 4).
        luck: uniform in [0, 1), shape (n, 2).
        optics: the cameras.
        lost_until: end of the last loss [s].

    Returns:
        rows (arrival, time of exposure, x, y, theta) of frames that see the body, shape (m, 5), and
        the new `lost_until`.
    """
    rows = np.empty((times.shape[0], 5))
    m = 0
    for k in range(times.shape[0]):
        t = times[k]
        if t >= lost_until and luck[k, 0] < optics.losing:
            lost_until = t - optics.lost * np.log1p(-luck[k, 1])
        if t < lost_until:
            continue
        latency = optics.latency + optics.jitter * noise[k, 3]
        rows[m, 0] = t + max(latency, 0.5 * optics.latency)
        rows[m, 1] = t
        rows[m, 2] = states[k, 0] + optics.noise * noise[k, 0]
        rows[m, 3] = states[k, 1] + optics.noise * noise[k, 1]
        rows[m, 4] = wrap_compiled(states[k, 2] + optics.spin_noise * noise[k, 2])
        m += 1
    return rows[:m], lost_until


class Camera:
    """The poses that the camera system reports for one body."""

    def __init__(self, mocap: Mocap, rng: np.random.Generator) -> None:
        # a fixed number of draws per exposure: results do not depend on how often poses are read
        noise_rng, loss_rng = rng.spawn(2)
        self._noise, self._luck = Draws(noise_rng.standard_normal, 4), Draws(loss_rng.random, 2)
        self._optics = Optics(
            mocap.noise,
            float(np.radians(mocap.noise_deg)),
            mocap.latency_s,
            mocap.jitter_s,
            mocap.dropout_rate / mocap.rate_hz,
            mocap.dropout_s,
        )
        self._lost_until = -np.inf
        self._photograph = settled(photograph)
        self._on_the_way: list[list[float]] = []  # (arrival, capture, x, y, theta), sorted

    def expose(self, times: Array, states: Array) -> None:
        """Take the exposures at `times`.

        Args:
            times: of the exposures, shape (n,) [s].
            states: true x, y, theta, ... at these times, shape (n, 6).
        """
        n = len(times)
        rows, self._lost_until = self._photograph(
            times,
            np.ascontiguousarray(states),
            self._noise.take(n),
            self._luck.take(n),
            self._optics,
            self._lost_until,
        )
        self._on_the_way += rows.tolist()
        self._on_the_way.sort()

    def arrived(self, now: float) -> list[PoseSample]:
        """Poses that have arrived by `now` since the last call, in order of arrival."""
        count = bisect_right(self._on_the_way, now, key=itemgetter(0))
        here, self._on_the_way = self._on_the_way[:count], self._on_the_way[count:]
        return [PoseSample(t, x, y, theta) for _, t, x, y, theta in here]
