"""The process while it flies: what would make it stumble is handled here and nowhere else."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def steady() -> Iterator[None]:
    """No garbage collection meanwhile.

    A flight makes frozen values without cycles, which reference counting frees at once; the
    collector would walk hundreds of thousands of them to find nothing.
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
        gc.unfreeze()
