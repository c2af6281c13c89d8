"""Waiting for what another thread or process does: often looked at, never slept through."""

import threading
from collections.abc import Callable

import pytest

LOOK_S = 0.005
LOOKS = 6000


def wait_for(condition: Callable[[], object]) -> None:
    """Until it holds; half a minute at most."""
    for _ in range(LOOKS):
        if condition():
            return
        threading.Event().wait(LOOK_S)
    pytest.fail("half a minute is enough")
