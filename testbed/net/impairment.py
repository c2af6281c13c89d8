"""Simulated network impairment: loss and delay of incoming messages."""

from collections.abc import Callable

import numpy as np

from testbed.core.lab import Impairment


def calm() -> tuple[float, float]:
    """No injected fault: no extra delay [s], no loss."""
    return 0.0, 0.0


class NetworkImpairment:
    """Loss or delay of each message; `worse` returns what an injected fault adds."""

    def __init__(
        self, impairment: Impairment, seed: int, name: str,
        worse: Callable[[], tuple[float, float]] = calm,
    ) -> None:  # fmt: skip
        self._w, self._worse = impairment, worse
        key = tuple(name.encode())
        self._rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))

    def arrival(self, t_ns: int) -> int | None:
        """When a message that arrived at `t_ns` is delivered; None: it is lost."""
        lost, where = self._rng.random(2)
        later, loss = self._worse()
        if lost < max(self._w.loss, loss):
            return None
        delay = later + self._w.delay_s + self._w.spread_s * (2.0 * float(where) - 1.0)
        return t_ns + round(1e9 * max(0.0, delay))
