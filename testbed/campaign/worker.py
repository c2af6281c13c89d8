"""A worker process: reads tasks from stdin and writes results to stdout, one JSON per line.

    python -m testbed.campaign.worker < tasks

The first line is the text of the base experiment; each further line is a run's number and its
overrides. A pool of these does not import the caller's `__main__`, so it works in notebooks and in
scripts without a main guard.
"""

import os
import sys

import msgspec

from testbed.campaign.row import Task
from testbed.campaign.trial import fly


def main() -> None:
    """Fly tasks until stdin ends."""
    results = os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(2, 1)  # keeps a law's prints out of the results
    base: str = msgspec.json.decode(sys.stdin.buffer.readline(), type=str)
    for line in sys.stdin.buffer:
        k, overrides = msgspec.json.decode(line, type=Task)
        results.write(msgspec.json.encode(fly(base, k, overrides)) + b"\n")


if __name__ == "__main__":
    main()
