"""What every worker of this machine does first: be quiet, and leave Ctrl-C to the campaign.

What a law prints goes where errors go: the output is the campaign's, which may be JSON.
"""

import logging
import os
import signal
from typing import Any


def dask_setup(worker: Any) -> None:
    """Called by Dask in the worker's main thread."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.dup2(2, 1)
    logging.disable(logging.CRITICAL)  # a run that fails says so in its result
