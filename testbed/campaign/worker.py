"""A worker process: reads orders from stdin and writes results to stdout, one JSON per line.

    python -m testbed.campaign.worker < orders

A pool of these does not import the caller's `__main__`, so it works in notebooks and in scripts
without a main guard.
"""

import os
import sys

import msgspec
from msgspec import Struct

from testbed.campaign.trial import fly


class Order(Struct, frozen=True, array_like=True):
    """A run to fly."""

    k: int  # its number
    base: str  # text of its experiment; empty: that of the order before
    overrides: tuple[str, ...] = ()  # "key=value"


def main() -> None:
    """Fly until stdin ends."""
    results = os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(2, 1)  # keeps a law's prints out of the results
    base = ""
    for line in sys.stdin.buffer:
        order = msgspec.json.decode(line, type=Order)
        base = order.base or base
        results.write(msgspec.json.encode(fly(base, order.k, order.overrides)) + b"\n")


if __name__ == "__main__":
    main()
