"""The five elements of the formation once a second, for the log."""

from bisect import bisect_left
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from testbed.metrics.characterisation import Characterisation, characterise_each

Array = NDArray[np.float64]

PERIOD_S = 1.0  # between two of them [s]


class FormationLog:
    """Picks times, and computes the elements of many together: a call costs more than a time."""

    def __init__(self) -> None:
        self._next = 0.0  # next time to log [s]
        self._times: list[float] = []  # picked, not computed yet
        self._states: list[Array] = []
        self._found: dict[float, Characterisation] = {}

    def note(self, times: Sequence[float], states: Array) -> bool:
        """Pick some of these times; whether there are any.

        Args:
            times: n of them [s].
            states: true ones of the vehicles at these times, (n, v, 6).
        """
        if states.shape[1] < 2:
            return False
        before, k = len(self._times), bisect_left(times, self._next)
        while k < len(times):
            self._next = times[k] + PERIOD_S - 1e-6  # ticks are sums of periods
            self._times.append(times[k])
            self._states.append(states[k])
            k = bisect_left(times, self._next, k)
        return len(self._times) > before

    def found(self) -> Mapping[float, Characterisation]:
        """The elements at all times picked so far, by time [s]."""
        if self._times:
            x = np.array(self._states)
            each = characterise_each(x[:, :, :2], x[:, :, 3:5])
            self._found |= zip(self._times, each, strict=True)
            self._times, self._states = [], []
        return self._found
