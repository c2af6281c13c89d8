"""Outlives a run: kills children that hang after it, and removes the run's folder.

Started as a script, so that it imports nothing of the project:

    python -SEI guardian.py GRACE_S FOLDER

Standard input brings the process ids of the children and closes when the run has ended.
"""

import os
import select
import shutil
import signal
import sys
import time
from contextlib import suppress


def main() -> None:
    """Wait for the children, at most the time of grace; then kill those that are left."""
    grace_s, folder = float(sys.argv[1]), sys.argv[2]
    left: set[int] = set()
    poll = select.poll()
    for line in sys.stdin:
        with suppress(OSError):  # it has ended
            left.add(os.pidfd_open(int(line)))
    for fd in left:
        poll.register(fd, select.POLLIN)
    end = time.monotonic() + grace_s
    while left and (rest := end - time.monotonic()) > 0:
        for fd, _ in poll.poll(1e3 * rest):
            poll.unregister(fd)
            left.discard(fd)
    for fd in left:
        with suppress(OSError):
            signal.pidfd_send_signal(fd, signal.SIGKILL)
    shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()
