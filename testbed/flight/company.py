"""The vehicles that a law knows of at a tick."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.law import Neighbours


class Company(NamedTuple):
    """Vehicles that are heard, and may speak."""

    names: tuple[str, ...]  # sorted
    order: NDArray[np.int64]  # their rows among the states heard
    strangers: Neighbours  # them, without states


def meet(
    received: tuple[str, ...], spoke: tuple[str, ...], who: Mapping[str, int], distance: float,
    message_size: int,
) -> Company:  # fmt: skip
    """The company when the states of `received` and messages of `spoke` have arrived.

    Args:
        received: names, in the order of the states.
        spoke: names; a law with messages knows no other before the first one.
        who: index of each vehicle in the formation.
        distance: to keep from each [m].
        message_size: numbers in a message of the law; 0: it needs none.
    """
    names = tuple(sorted(set(received) & set(spoke) if message_size else received))
    order = np.array([received.index(one) for one in names], np.int64)
    return Company(names, order, _strangers(names, who, distance, message_size))


def _strangers(
    names: tuple[str, ...], who: Mapping[str, int], distance: float, message_size: int
) -> Neighbours:
    """Neighbours without states: what is known before their first message."""
    n, k = len(names), message_size
    return Neighbours(
        np.zeros((n, 2)),
        np.zeros((n, 2)),
        np.full(n, distance),
        np.array([who.get(name, -1) for name in names], dtype=np.int64),
        np.zeros((n, k)),
        np.zeros(n),
    )
