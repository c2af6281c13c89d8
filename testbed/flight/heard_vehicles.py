"""The other vehicles that a law has heard of at a tick."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.law import Neighbours


class HeardVehicles(NamedTuple):
    """Vehicles whose states, and messages if the law needs them, have arrived."""

    names: tuple[str, ...]  # sorted
    order: NDArray[np.int64]  # their rows among the states heard
    neighbours: Neighbours  # the same, before their states and messages are filled in


def heard_vehicles(
    received: tuple[str, ...], spoke: tuple[str, ...], who: Mapping[str, int], distance: float,
    message_size: int,
) -> HeardVehicles:  # fmt: skip
    """The vehicles heard when states of `received` and messages of `spoke` have arrived.

    Args:
        received: names, in the order of the states.
        spoke: names; a law with messages knows no other before the first one.
        who: index of each vehicle in the formation.
        distance: to keep from each [m].
        message_size: numbers in a message of the law; 0: it needs none.
    """
    names = tuple(sorted(set(received) & set(spoke) if message_size else received))
    order = np.array([received.index(one) for one in names], np.int64)
    return HeardVehicles(names, order, _without_states(names, who, distance, message_size))


def _without_states(
    names: tuple[str, ...], who: Mapping[str, int], distance: float, message_size: int
) -> Neighbours:
    """Neighbours of which only the experiment is known; the rest is zero."""
    n, k = len(names), message_size
    return Neighbours(
        np.zeros((n, 2)),
        np.zeros((n, 2)),
        np.full(n, distance),
        np.array([who.get(name, -1) for name in names], dtype=np.int64),
        np.zeros((n, k)),
        np.zeros(n),
    )
