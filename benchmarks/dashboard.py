"""What looking on costs the flight: the loop's lateness without a viewer, with one, and with one
that is stopped (SIGSTOP) or killed.

    python benchmarks/dashboard.py [--seconds 20] [--rounds 3] [--speed 10] [--growth 0]

The flight is three vehicles at 10 ticks a second of the run, SPEED times as fast as real time. The
cases take turns, so that a busy machine is busy for all of them; what counts are the ratios, and
that of `again`, which is absent once more, tells what they are worth. The loop runs under
SCHED_FIFO where that is allowed, as it does on wires; `--ordinary` does without.
`--growth S` flies S seconds of the run with a viewer, and with one that is stopped, and prints what
memory the loop, the process that tells the viewer, and the viewer had meanwhile.
"""

import argparse
import os
import signal
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event, Thread

import numpy as np

from testbed.cli.dash import Dashboard, address_for
from testbed.config import Experiment, dump, find, load
from testbed.logs.history import gather
from testbed.logs.log_reader import LogReader
from testbed.rig.wired.wired_flight import PRIORITY
from testbed.run.fly import fly_and_judge
from testbed.run.folder import write_config

SETTLE_S = 1.0
CASES = ("absent", "attached", "stopped", "killed", "again")


@contextmanager
def looked_at(folder: Path, case: str, since: list[float]) -> Iterator[Dashboard | None]:
    """The dashboard on the run, and what happens to its viewer two seconds later.

    The time of that goes into `since`: a viewer that starts takes a core for itself.
    """
    board, left = Dashboard(folder, "headless", address_for()), Event()

    def look() -> None:
        board.open(left.wait)
        left.wait(2.0)
        if case == "stopped":
            board.viewer.send_signal(signal.SIGSTOP)
        if case == "killed":
            board.viewer.kill()
        since.append(time.monotonic())
        left.wait()

    if case in ("absent", "again"):
        since.append(time.monotonic())
        yield None
        return
    thread = Thread(target=look)
    thread.start()
    try:
        yield board
    finally:
        left.set()
        thread.join()
        board.close()


@contextmanager
def ahead(priority: int) -> Iterator[None]:
    """Run this thread at real-time priority; not the thread that starts viewers."""
    with suppress(OSError):
        policy = os.SCHED_FIFO if priority else os.SCHED_OTHER
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def make_run(folder: Path, seconds: float) -> Experiment:
    """Experiment and run folder of a case."""
    experiment = load(find("zhang2023_table"), [f"duration_s={seconds}"])
    folder.mkdir()
    write_config(folder, dump(experiment), "benchmark")
    return experiment


def lateness(folder: Path, case: str, seconds: float, speed: float, priority: int) -> np.ndarray:
    """Lateness of every tick, from a second after the case begins [s]."""
    experiment, since, began = make_run(folder, speed * seconds), [], time.monotonic()
    with looked_at(folder, case, since), ahead(priority):
        fly_and_judge(experiment, folder, speed=speed)
    loop = gather(LogReader(folder / "log.mcap")).loop
    counts = loop[loop[:, 0] > speed * (since[0] - began + SETTLE_S), 1]
    if len(counts) < 100:
        raise RuntimeError(f"{case}: {len(counts)} ticks are too few; expected a larger --seconds")
    return counts


def compare(folder: Path, seconds: float, rounds: int, speed: float, priority: int) -> None:
    late: dict[str, list[np.ndarray]] = {case: [] for case in CASES}
    for n in range(rounds):
        for case in CASES:
            late[case].append(lateness(folder / f"{case}{n}", case, seconds, speed, priority))
    absent = np.percentile(np.concatenate(late["absent"]), 99)
    print("viewer     p50 [ms]  p99 [ms]  max [ms]  p99 / absent")
    for case in CASES:
        all_of_it = 1e3 * np.concatenate(late[case])
        p50, p99 = np.percentile(all_of_it, [50, 99])
        print(
            f"{case:9s} {p50:9.3f} {p99:9.3f} {all_of_it.max():9.1f} {p99 / (1e3 * absent):11.2f}"
        )


def resident(process: int | str) -> float:
    """Memory of a process, 0 after its end [MB]."""
    try:
        words = Path(f"/proc/{process}/status").read_text().split()
    except OSError:
        return 0.0
    return int(words[words.index("VmRSS:") + 1]) / 1024 if "VmRSS:" in words else 0.0


def grow(folder: Path, seconds: float, speed: float) -> None:
    print("memory [MB]       of the run   loop  feeder  viewer")
    for case in ("attached", "stopped"):
        run = folder / f"growth_{case}"
        experiment, over = make_run(run, seconds), Event()
        seen: list[tuple[float, ...]] = []
        with looked_at(run, case, []) as board:

            def watch(board=board, seen=seen, over=over) -> None:
                while not over.wait(0.5):
                    others = (p.pid for p in (board.feeder, board.viewer) if p is not None)
                    seen.append((resident("self"), *map(resident, others)))

            thread = Thread(target=watch)
            thread.start()
            fly_and_judge(experiment, run, speed=speed)
            over.set()
            thread.join()
        for share in (0.1, 0.25, 0.5, 0.75, 1.0):
            row = seen[max(0, round(share * len(seen)) - 1)]
            numbers = "".join(f"{one:8.0f}" for one in row)
            print(f"{case:9s} after {share * seconds:7.0f} s {numbers}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="per case and round")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--speed", type=float, default=10.0)
    parser.add_argument("--ordinary", action="store_true", help="the loop has no priority")
    parser.add_argument("--growth", type=float, default=0.0, help="seconds of the run")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if options.rounds:
            priority = 0 if options.ordinary else PRIORITY
            compare(Path(folder), options.seconds, options.rounds, options.speed, priority)
        if options.growth:
            grow(Path(folder), options.growth, options.speed)


if __name__ == "__main__":
    main()
