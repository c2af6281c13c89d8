"""A process that flies runs: tasks come in on stdin, results go out on stdout, one JSON a line.

    python -m testbed.campaign.worker < tasks

The first line is the text of the base experiment, every other one a run's number and its
overrides. A pool of these needs nothing of the caller's `__main__`, so it works from scripts
without a guard and from notebooks.
"""

import os
import sys

import msgspec

from testbed.campaign.row import Task
from testbed.campaign.trial import fly


def main() -> None:
    """Fly until stdin ends."""
    results = os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(2, 1)  # what a law prints is no result
    base: str = msgspec.json.decode(sys.stdin.buffer.readline(), type=str)
    for line in sys.stdin.buffer:
        k, overrides = msgspec.json.decode(line, type=Task)
        results.write(msgspec.json.encode(fly(base, k, overrides)) + b"\n")


if __name__ == "__main__":
    main()
