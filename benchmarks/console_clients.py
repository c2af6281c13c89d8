"""Cost for the flight of five browsers at the operator's page, one of them stalled.

    python benchmarks/console_clients.py [--seconds 20] [--rounds 3] [--speed 10]

The flight is three vehicles at 10 ticks a second of the run, SPEED times real time, under
SCHED_FIFO where that is allowed, as on wires. Cases take turns in one run, so what counts are the
ratios, of all rounds together and the median of those of each round. `again` is without a page once
more: what a ratio is worth. `idle` has the page and five connections that ask nothing.
Readers ask as the page does. The stalled one asks five hundred times and reads nothing. `cpu` is
the share of a core that the page's process takes, and one reader.
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
from typing import NamedTuple

import numpy as np

from testbed.config import dump, find, load
from testbed.logs.history import gather
from testbed.logs.log_reader import LogReader
from testbed.rig.wired.wired_flight import PRIORITY
from testbed.run.fly import fly_and_judge
from testbed.run.folder import write_config

CASES = ("absent", "idle", "page", "five", "again")
READERS = 4  # and the stalled one
READ = """
import http.client, json, sys, time
link, version, count = http.client.HTTPConnection("127.0.0.1", int(sys.argv[1])), "", 0
try:
    link.connect()
    if sys.argv[2] == "idle":
        sys.stdin.read()
    while True:
        link.request("GET", f"/picture?after={version}")
        version = json.loads(link.getresponse().read())["v"]
        count += 1
        print(count, flush=True)
except (OSError, http.client.HTTPException):
    pass
"""


class Seen(NamedTuple):
    """What one case and round showed."""

    late: np.ndarray  # of every tick [s]
    pictures: list[int]  # per reader
    page_cpu: float  # share of a core
    reader_cpu: float


def cpu_s(pid: int) -> float:
    """Processor time of a process so far [s]."""
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def watched(folder: Path, case: str, found: dict[str, list[float]]) -> Iterator[None]:
    """The page of a run and its readers; `found` gets pictures and processor times."""
    if case in ("absent", "again"):
        yield
        return
    command = [sys.executable, "-m", "testbed.console.process", str(folder), "127.0.0.1", "0"]
    page = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    port = page.stderr.readline().rstrip().rpartition(":")[2].rstrip("/")
    readers = [
        subprocess.Popen(
            [sys.executable, "-c", READ, port, case],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )
        for _ in range(1 if case == "page" else READERS)
    ]  # fmt: skip
    try:
        with socket.create_connection(("127.0.0.1", int(port))) as stalled:
            if case == "five":
                stalled.sendall(b"GET /picture?after= HTTP/1.1\r\nHost: localhost\r\n\r\n" * 500)
            before = [cpu_s(one.pid) for one in (page, *readers)]
            yield
            after = [cpu_s(one.pid) for one in (page, *readers)]
            found["cpu"] = [b - a for a, b in zip(before, after, strict=True)]
    finally:
        page.terminate()
        page.wait()
        for one in readers:
            said = one.communicate(timeout=20)[0].split()
            found["pictures"].append(int(said[-1]) if said else 0)


def look(folder: Path, case: str, seconds: float, speed: float) -> Seen:
    """Fly once."""
    found: dict[str, list[float]] = {"pictures": [], "cpu": [0.0, 0.0]}
    experiment = load(find("zhang2023_table"), [f"duration_s={speed * seconds}"])
    folder.mkdir()
    write_config(folder, dump(experiment), "benchmark")
    with watched(folder, case, found):
        with suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
        try:
            fly_and_judge(experiment, folder, speed=speed)
        finally:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    late = gather(LogReader(folder / "log.mcap")).loop[10:, 1]
    page, *readers = (one / seconds for one in found["cpu"])
    return Seen(late, found["pictures"], page, max(readers))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=20.0, help="per case and round")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--speed", type=float, default=10.0)
    options = parser.parse_args()
    seen: dict[str, list[Seen]] = {case: [] for case in CASES}
    print(f"load average {os.getloadavg()[0]:.1f}", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for n in range(options.rounds):
            for case in CASES:
                where = Path(folder) / f"{case}{n}"
                seen[case].append(look(where, case, options.seconds, options.speed))
    absent = [p99(one.late) for one in seen["absent"]]
    print("case     p50 [ms]  p99 [ms]  max [ms]  p99 / absent  median of rounds"
          "  pictures/s  cpu page  cpu reader")  # fmt: skip
    for case, rounds in seen.items():
        every = np.concatenate([one.late for one in rounds])
        together = p99(every) / p99(np.concatenate([one.late for one in seen["absent"]]))
        median = np.median([p99(one.late) / base for one, base in zip(rounds, absent, strict=True)])
        pictures = np.mean([n for one in rounds for n in one.pictures] or [0.0]) / options.seconds
        cpu = [np.mean([one[k] for one in rounds]) for k in (2, 3)]
        print(f"{case:8s} {1e3 * np.median(every):8.3f} {1e3 * p99(every):9.3f}"
              f" {1e3 * every.max():9.1f} {together:13.2f} {median:17.2f} {pictures:11.1f}"
              f" {cpu[0]:9.1%} {cpu[1]:11.1%}")  # fmt: skip


def p99(late: np.ndarray) -> float:
    return float(np.percentile(late, 99))


if __name__ == "__main__":
    main()
