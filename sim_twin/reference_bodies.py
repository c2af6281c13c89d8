"""Bodies that stand still on the table, as the cameras see them."""

from collections.abc import Mapping

import numpy as np

from sim_twin.fault_injection import FaultInjector
from sim_twin.randomness import stream
from testbed.core.table import Mocap
from testbed.core.types import PoseSample


class ReferenceBodies:
    """One pose of each body per look."""

    def __init__(
        self, places: Mapping[str, tuple[float, float, float]], mocap: Mocap, seed: int
    ) -> None:
        self._places, self._latency = places, mocap.latency_s
        self._sigma = mocap.noise, mocap.noise, float(np.radians(mocap.noise_deg))
        self._rng = stream(seed, "reference bodies")

    def seen(self, now: float, injector: FaultInjector | None) -> dict[str, PoseSample]:
        """Poses of the bodies after faults of the cameras; a body that is not seen is missing."""
        found = {}
        for name, place in self._places.items():
            noise = self._rng.standard_normal(3)
            x, y, theta = (np.array(place) + self._sigma * noise).tolist()
            # before the flight a fault that begins with it is seen already
            seen = PoseSample(max(0.0, now - self._latency), x, y, theta)
            samples = [seen] if injector is None else injector.poses(name, [seen])
            if samples:
                found[name] = samples[-1]
        return found
