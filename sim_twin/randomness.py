"""All chance in the twin comes from one seed; every part draws from a stream of its own.

A stream is known by its name, so adding a vehicle or a camera does not change what the others draw.
"""

import numpy as np


def stream(seed: int, *name: str) -> np.random.Generator:
    """The generator of the part called `name`, for instance ("sat1", "camera")."""
    key = tuple("/".join(name).encode())
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
