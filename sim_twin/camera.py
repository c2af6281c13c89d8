"""Motion capture: true states in, late and noisy poses out."""

import numpy as np
from numpy.typing import NDArray

from testbed.core.table import Mocap
from testbed.core.types import PoseSample

Array = NDArray[np.float64]


class Camera:
    """What the camera system reports of one body."""

    def __init__(self, mocap: Mocap, rng: np.random.Generator) -> None:
        self._mocap = mocap
        # a fixed number of draws per exposure: what is seen does not depend on how often one looks
        self._noise_rng, self._loss_rng = rng.spawn(2)
        self._noise = np.array([mocap.noise, mocap.noise, np.radians(mocap.noise_deg)])
        self._lost_until = -np.inf
        self._on_the_way: list[tuple[float, PoseSample]] = []  # (arrival, sample)

    def expose(self, times: Array, states: Array) -> None:
        """Take pictures.

        Args:
            times: of the exposures, shape (n,) [s].
            states: true x, y, theta, ... then, shape (n, 6).
        """
        mocap, n = self._mocap, len(times)
        chance = self._noise_rng.standard_normal((n, 4))
        poses = states[:, :3] + self._noise * chance[:, :3]
        poses[:, 2] = (poses[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
        poses[poses[:, 2] >= np.pi, 2] = -np.pi  # rounded up, see se2.wrap
        latency = mocap.latency_s + mocap.jitter_s * chance[:, 3]
        arrival = times + np.maximum(latency, 0.5 * mocap.latency_s)
        kept = self._kept(times)
        rows = np.column_stack((arrival, times, poses))[kept].tolist()
        self._on_the_way += [(row[0], PoseSample(*row[1:])) for row in rows]

    def _kept(self, times: Array) -> NDArray[np.bool_]:
        """Which exposures still show the body."""
        mocap = self._mocap
        kept = times >= self._lost_until
        chance = self._loss_rng.random((len(times), 2))
        begins = chance[:, 0] < mocap.dropout_rate / mocap.rate_hz
        for k in np.nonzero(begins)[0].tolist():
            if kept[k]:
                self._lost_until = times[k] - mocap.dropout_s * np.log1p(-chance[k, 1])
                kept &= (times < times[k]) | (times >= self._lost_until)
        return kept

    def arrived(self, now: float) -> list[PoseSample]:
        """Poses that have arrived by `now` and were not asked for yet, in order of arrival."""
        here = sorted((pair for pair in self._on_the_way if pair[0] <= now), key=lambda p: p[0])
        self._on_the_way = [pair for pair in self._on_the_way if pair[0] > now]
        return [sample for _, sample in here]
