"""Laws that misbehave, on the twin and on the bench: how does each run end?

    python benchmarks/misbehaving_laws.py [LAW ...] [--rig twin] [--rig bench] [--signals N]

For each: exit code, time of the whole command, flight time from the misbehaviour to the end of the
flight, the words of the fault or the refusal, whether metrics.json and report.html are there, and
how many processes are left. Every one must be named and must not end with exit code 0. Then, on the
twin: from SIGINT, SIGTERM and SIGHUP to the end of the command, N times each.
"""

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import psutil

from testbed.realtime.wall_clock import monotonic_ns, sleep_until_ns

HEAD = """
import ctypes, os, shutil, signal, subprocess, sys, threading, time
import numpy as np
"""
BODY = """

class Mine:
    step_s = 0.05

    def force(self, own, neighbours, world, t):
        if t > 2.0:  # BEGINS
            {does}
        return 0.04 * own.mass * (world.goal.p - own.p) - 0.4 * own.mass * own.v
"""
CATCHES = """
            while True:
                try:
                    while True: pass
                except BaseException: pass"""
KILLS = """
            own_children = f"/proc/{os.getpid()}/task/{os.getpid()}/children"
            for child in open(own_children).read().split():
                os.kill(int(child), signal.SIGKILL)
            [][0]"""
IGNORES = """
            for number in (signal.SIGALRM, signal.SIGTERM, signal.SIGINT):
                signal.signal(number, signal.SIG_IGN)
            while True: pass"""
DELETES = """
            shutil.rmtree("{out}", ignore_errors=True)
            [][0]"""
IN_FLIGHT = {
    # does not return
    "hangs": "while True: pass",
    "hangs in C": "(lambda k: pow(7, k, k - 1))(3 ** 3_000_000)",  # no signal handler runs
    "hangs, catches all": CATCHES,
    "sleeps": "time.sleep(1000)",
    "waits for a lock": "(lambda lock: (lock.acquire(), lock.acquire()))(threading.Lock())",
    "recursion": "(lambda f: f(f))(lambda f: f(f))",
    "slow": "time.sleep(0.15)",  # twice in a jet period of 0.1 s
    "slow 1 of 50": "time.sleep(3.0 if int(20 * t) % 50 == 0 else 0.0)",
    # ends its process
    "sys.exit": "sys.exit(0)",
    "os._exit": "os._exit(0)",
    "killed": "os.kill(os.getpid(), signal.SIGKILL)",
    "crashes": "ctypes.string_at(8)",
    "stops itself": "os.kill(os.getpid(), signal.SIGSTOP)",
    # leaves something behind
    "forks": "os.fork()",
    "two forks": "[os.fork(), os.fork()]",
    "child": "subprocess.Popen(['sleep', '1000'])",
    "threads": "threading.Thread(target=time.sleep, args=(1000,)).start()",
    "memory": "self.kept = [*getattr(self, 'kept', []), np.ones(4_000_000)]",
    "kills a child": KILLS,
    # returns what is no force
    "nan": "return np.full(2, np.nan)",
    "nan after 5 s": "return np.full(2, np.nan if t > 5.0 else 0.0)",
    "inf": "return np.array([np.inf, 0.0])",
    "shape": "return np.zeros(3)",
    "complex": "return np.zeros(2) + 1j",
    "text": "return 'full ahead'",
    "nothing": "return None",
    "generator": "return (x for x in (0.0, 0.0))",
    "object dtype": "return np.array([object(), object()])",
    "huge": "return np.zeros(10_000_000)",
    # raises
    "raises": "return own.p / [][0]",
    "odd text": r"raise ValueError('\x00\x1b[2J\udcff' + 'x' * 1_000_000)",
    "no text": "raise type('Odd', (Exception,), {'__str__': lambda self: 1 / 0})()",
    "interrupts": "raise KeyboardInterrupt",
    # changes its process
    "closes 0 to 2": "[os.close(k) for k in range(3)]; [][0]",
    "closes all": "os.closerange(3, 1024); [][0]",
    "changes folder": "os.chdir('/'); [][0]",
    "alters stdout": "sys.stdout = sys.stderr = None; [][0]",
    "signal handlers": IGNORES,
    "deletes its log": DELETES,
}
AT_IMPORT = {
    "exits at import": "os._exit(0)",
    "hangs at import": "while True: pass",
    "raises at import": "1 / 0",
}
LAWS = [*IN_FLIGHT, *AT_IMPORT]
BEGINS = {"nan after 5 s": 5.0, "slow 1 of 50": 2.5}  # [s] of the flight; others: 2
PATIENCE_S = 300
NAMED = "law.py"


def command(folder, rig, *words):
    return [
        sys.executable, "-m", "testbed", "run", "hold", "--rig", rig, "criteria={}",
        "deploy.law_memory_mb=300", f"--out={folder}/out", *words,
    ]  # fmt: skip


def begin(words, folder):
    """The command; what it says is in `said`."""
    env = os.environ | {"TMPDIR": str(folder), "XDG_RUNTIME_DIR": str(folder)}
    env["XDG_STATE_HOME"] = str(folder / "state")
    with (folder / "said").open("w") as said:
        return subprocess.Popen(
            words, env=env, stdout=said, stderr=subprocess.STDOUT, start_new_session=True
        )


def pause():
    sleep_until_ns(monotonic_ns() + 20_000_000)


def try_law(name, rig, folder):
    """Run one law; return a line of the report."""
    does = IN_FLIGHT.get(name, "pass").replace("{out}", str(folder / "out"))
    text = HEAD + BODY.format(does=does)
    (folder / NAMED).write_text(text + AT_IMPORT.get(name, "") + "\n")
    override = f'controller={{type="python",law="{folder / NAMED}:Mine"}}'
    began = monotonic_ns()
    process = begin(command(folder, rig, "duration_s=8", override), folder)
    seen = {}
    while process.poll() is None and monotonic_ns() - began < 1e9 * PATIENCE_S:
        for one in psutil.Process(process.pid).children(recursive=True):
            seen[one.pid] = one
        pause()
    took = 1e-9 * (monotonic_ns() - began)
    left = [one for one in seen.values() if one.is_running()]
    for one in (*left, process):
        one.kill()
    process.wait()
    out, metrics = folder / "out", {}
    if (out / "metrics.json").exists():
        metrics = json.loads((out / "metrics.json").read_text())
    fault = metrics.get("fault") or ""
    text = (folder / "said").read_text()
    if not fault and (found := re.search(r"aborted by a fault: (.*)", text)):
        fault = found[1]
    if not fault and (found := re.search(r"found +(.*(?:\n    .*)*)", text)):
        fault = found[1]
    files = "".join(
        k for k, f in (("m", "metrics.json"), ("r", "report.html")) if (out / f).exists()
    )
    after = metrics.get("duration_s", 0.0) - BEGINS.get(name, 2.0)
    return process.returncode, took, after, fault, files, len(left), out.exists()


def to_the_end(number, folder):
    """Time from a signal to the end of the command [s], and whether the folder is complete."""
    process = begin(command(folder, "twin", "duration_s=4000"), folder)
    log = folder / "out" / "log.mcap"
    while not (log.exists() and log.stat().st_size > 200_000):
        assert process.poll() is None
        pause()
    began = monotonic_ns()
    process.send_signal(number)
    process.wait()
    took = 1e-9 * (monotonic_ns() - began)
    whole = all((folder / "out" / name).exists() for name in ("metrics.json", "report.html"))
    return took, whole and process.returncode == 130


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("laws", nargs="*", choices=[[], *LAWS], default=[])
    parser.add_argument("--rig", action="append", choices=["twin", "bench"])
    parser.add_argument("--signals", type=int, default=5)
    args = parser.parse_args()
    bad = 0
    for rig in args.rig or ["twin", "bench"]:
        for name in args.laws or LAWS:
            with tempfile.TemporaryDirectory(prefix="abt-laws-") as folder:
                code, took, after, fault, files, left, there = try_law(name, rig, Path(folder))
            whole = not there if name in AT_IMPORT else files == "mr"
            whole = whole or name == "deletes its log"
            good = (NAMED in fault) and whole and not left and code != 0
            bad += not good
            print(
                f"{rig:5s} {name:18s} code {code:3d} {took:6.1f} s, {after:4.1f} s after"
                f"  files {files:2s}  {left} left  {'ok ' if good else 'BAD'} {fault[:300]!r}",
                flush=True,
            )  # fmt: skip
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP) if args.signals else ():
        took = []
        for _ in range(args.signals):
            with tempfile.TemporaryDirectory(prefix="abt-laws-") as folder:
                seconds, whole = to_the_end(number, Path(folder))
            took.append(seconds)
            bad += not whole
        print(
            f"{number.name:8s} to the end: median {np.median(took):.2f} s, worst {max(took):.2f} s"
        )
    print(f"{bad} bad")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
