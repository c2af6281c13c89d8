"""Waiting times of a high-priority process at a pseudo-terminal on a busy machine.

    python benchmarks/pty_stall.py [--seconds 20] [--hogs 25]

One loop under SCHED_FIFO (where allowed) sends 90 bytes to itself every 10 ms, in turns through a
pty and through a socket pair, while so many other processes of ordinary priority do nothing but
compute. A pty's bytes are moved by a thread of the kernel that is one of those ordinary ones, and
`select` with a time-out of zero waits for it as well.
"""

import argparse
import os
import pty
import select
import socket
import tty

import numpy as np
from load import loaded

from testbed.realtime.scheduling import realtime_priority
from testbed.realtime.wall_clock import monotonic_ns, sleep_until_ns

MESSAGE = bytes(90)


def through_pty(near, far):
    """Time until a look without waiting returned, and until the bytes were there [ns]."""
    began = monotonic_ns()
    os.write(far, MESSAGE)
    select.select([near], [], [], 0)
    looked = monotonic_ns()
    count = 0
    while count < len(MESSAGE):
        select.select([near], [], [])
        count += len(os.read(near, 4096))
    return looked - began, monotonic_ns() - began


def through_socket(near, far):
    began = monotonic_ns()
    far.send(MESSAGE)
    select.select([near], [], [])
    near.recv(4096)
    return monotonic_ns() - began


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--hogs", type=int, default=25)
    args = parser.parse_args()
    master, slave = pty.openpty()
    tty.setraw(slave)
    one, other = socket.socketpair()
    rows = []
    with loaded(args.hogs), realtime_priority(30) as allowed:
        due = monotonic_ns()
        for _ in range(round(100 * args.seconds)):
            due += 10_000_000
            sleep_until_ns(due)
            rows.append((*through_pty(master, slave), through_socket(one, other)))
    print(
        f"{args.hogs} hogs, SCHED_FIFO {'allowed' if allowed else 'not allowed'}, {len(rows)} times"
    )
    print(f"{'':24s}{'p50':>10s}{'p99':>10s}{'p99.9':>10s}{'max [us]':>10s}")
    for name, row in zip(("a look at the pty", "bytes through the pty", "bytes through a socket"),
                         1e-3 * np.array(rows).T, strict=True):  # fmt: skip
        print(
            f"{name:24s}" + "".join(f"{np.percentile(row, q):10.0f}" for q in (50, 99, 99.9, 100))
        )


if __name__ == "__main__":
    main()
