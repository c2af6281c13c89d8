"""Setup of each worker on this machine: silence its logs and ignore Ctrl-C.

A law's prints go to standard error, because standard output is the campaign's, which may be JSON.
"""

import logging
import os
import signal
from typing import Any


def dask_setup(worker: Any) -> None:
    """Called by Dask in the worker's main thread."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT, signal.SIGTERM))  # of `held_back`
    os.dup2(2, 1)
    logging.disable(logging.CRITICAL)  # a failed run is reported in its result
