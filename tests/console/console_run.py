"""A run with the operator's page, and waiting for what its page shows."""

import subprocess
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any

PATIENCE_S = 240.0  # of the test, not of what is tested
LOOK_S = 0.05


def eventually(look: Callable[[], Any], what: str) -> Any:
    """The first true value of `look`; `what` names what was expected."""
    for _ in range(round(PATIENCE_S / LOOK_S)):
        with suppress(ConnectionError):  # the page is being loaded anew
            if found := look():
                return found
        threading.Event().wait(LOOK_S)
    raise AssertionError(f"never: {what}")


def address(run: "subprocess.Popen[str]") -> str:
    """The page's address, as the run prints it; what it prints later is dropped."""
    assert run.stderr is not None
    for line in run.stderr:
        if line.startswith("console: "):
            threading.Thread(target=run.stderr.read, daemon=True).start()
            return line.split()[-1]
    raise AssertionError("no page")
