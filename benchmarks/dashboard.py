"""What looking on costs the flight: the loop's lateness without a viewer, with one, and with one
that is stopped (SIGSTOP) or killed.

    python benchmarks/dashboard.py [SECONDS PER CASE AND ROUND, 10] [ROUNDS, 3] [SPEED, 10]

The flight is three vehicles at 10 ticks a second of the run, SPEED times as fast as real time. The
cases take turns, so that a busy machine is busy for all of them; what counts are the ratios.
"""

import signal
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread

import numpy as np

from testbed.cli.dash import Dashboard, address_for
from testbed.cli.run import fly_and_judge
from testbed.config import dump, find, load
from testbed.ops.feed import LogFeed
from testbed.ops.folder import write_config
from testbed.ops.history import gather
from testbed.ops.logbook import Logbook

CASES = ("absent", "attached", "stopped", "killed")
SPEED = float(sys.argv[3]) if len(sys.argv) > 3 else 10.0


@contextmanager
def looked_at(folder: Path, case: str) -> Iterator[None]:
    """The dashboard on the run, and what happens to its viewer a second later."""
    board, left = Dashboard(folder, "headless", address_for()), Event()

    def look() -> None:
        board.open(left.wait)
        left.wait(2.0)
        if case == "stopped":
            board.viewer.send_signal(signal.SIGSTOP)
        if case == "killed":
            board.viewer.kill()
        left.wait()

    if case == "absent":
        yield
        return
    thread = Thread(target=look)
    thread.start()
    try:
        yield
    finally:
        left.set()
        thread.join()
        board.close()


def lateness(folder: Path, case: str, seconds: float) -> np.ndarray:
    """Of every tick after the first three seconds [s]."""
    experiment = load(find("zhang2023_table"), [f"duration_s={SPEED * seconds}"])
    folder.mkdir()
    write_config(folder, dump(experiment), "benchmark")
    with looked_at(folder, case):
        fly_and_judge(experiment, folder, speed=SPEED)
    loop = gather(LogFeed(Logbook(folder / "log.mcap")).news()).loop
    return loop[loop[:, 0] > 3.0 * SPEED, 1]


def main() -> None:
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 10.0
    rounds = int(sys.argv[2]) if len(sys.argv) > 2 else 3
    late: dict[str, list[np.ndarray]] = {case: [] for case in CASES}
    with tempfile.TemporaryDirectory() as folder:
        for n in range(rounds):
            for case in CASES:
                late[case].append(lateness(Path(folder) / f"{case}{n}", case, seconds))
    absent = np.percentile(np.concatenate(late["absent"]), 99)
    print("viewer     p50 [ms]  p99 [ms]  max [ms]  p99 / absent")
    for case in CASES:
        all_of_it = 1e3 * np.concatenate(late[case])
        p50, p99 = np.percentile(all_of_it, [50, 99])
        print(
            f"{case:9s} {p50:9.3f} {p99:9.3f} {all_of_it.max():9.1f} {p99 / (1e3 * absent):11.2f}"
        )


if __name__ == "__main__":
    main()
