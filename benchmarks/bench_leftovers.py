"""Runs on the bench that end normally, by Ctrl-C and by SIGKILL of the parent: what is left?

    python benchmarks/bench_leftovers.py [--count 20] [--seed S]

Looks for processes, listening sockets, folders and links that were not there before.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import psutil

from testbed.realtime.wall_clock import monotonic_ns, sleep_until_ns

WAYS = ("normal end", "Ctrl-C", "SIGKILL")
PATIENCE_NS = 300 * 10**9


def pause():
    sleep_until_ns(monotonic_ns() + 20_000_000)


def tree(pid):
    try:
        return psutil.Process(pid).children(recursive=True)
    except psutil.NoSuchProcess:
        return []


def sockets(processes):
    """Ports that these processes listen at."""
    found = set()
    for one in processes:
        try:
            found |= {(c.type, c.laddr.port) for c in one.net_connections("inet") if not c.raddr}
        except psutil.Error:
            continue
    return found


def run(way, rng, folder):
    """Fly once; return the processes and files that are left."""
    env = os.environ | {"TMPDIR": str(folder), "XDG_RUNTIME_DIR": str(folder)}
    env["XDG_STATE_HOME"] = str(folder / "state")  # a killed run leaves its latch there
    process = subprocess.Popen(
        [sys.executable, "-m", "testbed", "run", "hold", "duration_s=3", "criteria={}",
         "--rig", "bench", "--out", str(folder / "out")],
        env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    seen, end = {}, monotonic_ns() + PATIENCE_NS
    ready = None
    # at any moment: while it starts, or while it flies
    delay = round(1e9 * rng.uniform(0.0, 8.0))
    while process.poll() is None and monotonic_ns() < end:
        seen |= {one.pid: one for one in tree(process.pid)}
        if ready is None and len(seen) > 2:
            ready = monotonic_ns()
        if way != "normal end" and ready is not None and monotonic_ns() - ready > delay:
            process.send_signal(signal.SIGINT if way == "Ctrl-C" else signal.SIGKILL)
            break
        pause()
    ports = sockets(seen.values())
    process.wait(120)
    _, alive = psutil.wait_procs(list(seen.values()), timeout=60)
    here = [p for p in folder.rglob("*") if (folder / "out") not in (p, *p.parents)]
    here = [
        p for p in here if p.name.startswith(("airbearing-", "serial-")) and "testbed" not in p.name
    ]
    taken = sockets(psutil.process_iter()) & ports if os.geteuid() == 0 else set()
    return process.returncode, len(alive), len(here), len(taken)


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    total = np.zeros(3, dtype=int)
    for k in range(args.count):
        way = WAYS[k % len(WAYS)]
        with tempfile.TemporaryDirectory(prefix="abt-left-") as folder:
            code, *left = run(way, rng, Path(folder))
        total += left
        print(f"{way:12s} code {code:4d}: {left} processes, files, ports left", flush=True)
    print(f"{args.count} runs: {total.tolist()} processes, files, ports left behind")
    return int(total.any())


if __name__ == "__main__":
    sys.exit(main())
