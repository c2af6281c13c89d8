"""Cost for the flight of five browsers at the operator's page, one of them stalled.

    python benchmarks/console_clients.py [--seconds 20] [--rounds 3] [--speed 10]

The flight is three vehicles at 10 ticks a second of the run, SPEED times real time, under
SCHED_FIFO where that is allowed, as on wires. Cases take turns in one run, so what counts are the
ratios; `again` is without a page once more, and says what a ratio is worth. Readers ask as the page
does. The stalled one asks five hundred times and reads nothing.
"""

import argparse
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from testbed.config import dump, find, load
from testbed.logs.history import gather
from testbed.logs.log_reader import LogReader
from testbed.rig.wired.wired_flight import PRIORITY
from testbed.run.fly import fly_and_judge
from testbed.run.folder import write_config

CASES = ("absent", "page", "five", "again")
READERS = 4  # and the stalled one
READ = """
import http.client, json, sys, time
link, version, count = http.client.HTTPConnection("127.0.0.1", int(sys.argv[1])), "", 0
try:
    while True:
        link.request("GET", f"/picture?after={version}")
        version = json.loads(link.getresponse().read())["v"]
        count += 1
        print(count, flush=True)
except (OSError, http.client.HTTPException):
    pass
"""


@contextmanager
def watched(folder: Path, case: str, pictures: list[int]) -> Iterator[None]:
    """The page of a run and its readers."""
    if case in ("absent", "again"):
        yield
        return
    command = [sys.executable, "-m", "testbed.console.process", str(folder), "127.0.0.1", "0"]
    page = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    port = page.stderr.readline().rstrip().rpartition(":")[2].rstrip("/")
    readers = [
        subprocess.Popen([sys.executable, "-c", READ, port], stdout=subprocess.PIPE, text=True)
        for _ in range(READERS if case == "five" else 1)
    ]
    try:
        with socket.create_connection(("127.0.0.1", int(port))) as stalled:
            if case == "five":
                stalled.sendall(b"GET /picture?after= HTTP/1.1\r\nHost: localhost\r\n\r\n" * 500)
            yield
    finally:
        page.terminate()
        page.wait()
        for one in readers:
            said = one.communicate(timeout=20)[0].split()
            pictures.append(int(said[-1]) if said else 0)


def lateness(folder: Path, case: str, seconds: float, speed: float, pictures: list[int]):
    """Lateness of every tick [s]."""
    experiment = load(find("zhang2023_table"), [f"duration_s={speed * seconds}"])
    folder.mkdir()
    write_config(folder, dump(experiment), "benchmark")
    with watched(folder, case, pictures):
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        try:
            fly_and_judge(experiment, folder, speed=speed)
        finally:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return gather(LogReader(folder / "log.mcap")).loop[10:, 1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="per case and round")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--speed", type=float, default=10.0)
    options = parser.parse_args()
    late: dict[str, list[np.ndarray]] = {case: [] for case in CASES}
    pictures: dict[str, list[int]] = {case: [] for case in CASES}
    print(f"load average {os.getloadavg()[0]:.1f}", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for n in range(options.rounds):
            for case in CASES:
                one = lateness(
                    Path(folder) / f"{case}{n}", case, options.seconds, options.speed,
                    pictures[case],
                )  # fmt: skip
                late[case].append(one)
    absent = np.percentile(np.concatenate(late["absent"]), 99)
    print("case     p50 [ms]  p99 [ms]  max [ms]  p99 / absent  pictures per reader and second")
    for case in CASES:
        every = 1e3 * np.concatenate(late[case])
        p50, p99 = np.percentile(every, [50, 99])
        rate = np.mean(pictures[case]) / options.seconds if pictures[case] else 0.0
        print(f"{case:8s} {p50:8.3f} {p99:9.3f} {every.max():9.1f} {p99 / (1e3 * absent):13.2f}"
              f" {rate:10.1f}")  # fmt: skip


if __name__ == "__main__":
    main()
