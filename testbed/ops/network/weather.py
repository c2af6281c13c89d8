"""Bad weather on the network, made on purpose: loss and delay of what comes in."""

import numpy as np

from testbed.core.lab import Weather


class Storm:
    """Decides about one message after the other."""

    def __init__(self, weather: Weather, seed: int, name: str) -> None:
        self._w = weather
        key = tuple(name.encode())
        self._rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))

    def arrival(self, t_ns: int) -> int | None:
        """When a message that came in at `t_ns` is let through; None: it is lost."""
        lost, where = self._rng.random(2)
        if lost < self._w.loss:
            return None
        delay = self._w.delay_s + self._w.spread_s * (2.0 * float(where) - 1.0)
        return t_ns + round(1e9 * max(0.0, delay))
