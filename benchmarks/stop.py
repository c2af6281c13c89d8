"""`testbed stop` under bad conditions: stop three vehicles on the bench, and see the valves close.

    python benchmarks/stop.py [CONDITION ...] [--count N] [--seed S] [--hogs N]

    plain       the operator's terminal is that of the host
    other-env   ssh, sudo, cron: no environment, so no note is found; with --connect
    no-note     the host could not write its note: its folder is a file; with --connect
    squatted    others can write to the folder of notes, so it is refused; with --connect
    host-hangs  the host's process is stopped (SIGSTOP)
    host-dead   the host's process was killed just before

Each flight is stopped at a random instant by the first command. The second one, 0.6 s later, shuts
valves and air at once. Printed are the time from the start of the second command to the last
valve's closing by the stamps of the boards, and whether the first command named every vehicle and
ended with 0.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import msgspec
import numpy as np
from bench_kills import BUSY, FLEET, HOST, Host, await_gone, last_open_us
from load import loaded

from testbed.realtime.wall_clock import monotonic_ns, sleep_until_ns
from testbed.rig.wired.table_report import TableReport

CONDITIONS = ("plain", "other-env", "no-note", "squatted", "host-hangs", "host-dead")
GAP_NS = 600_000_000
PROGRAM = HOST.replace(", relay=way", "")  # the vehicles know the port of the host


def surroundings(condition, folder):
    """The environment of the host and of the operator."""
    own = os.environ | {"XDG_RUNTIME_DIR": str(folder)}
    if condition == "no-note":
        (folder / "file").touch()
        return own | {"XDG_RUNTIME_DIR": str(folder / "file")}, own
    if condition == "squatted":
        (folder / f"airbearing-testbed-{os.getuid()}").mkdir()
        (folder / f"airbearing-testbed-{os.getuid()}").chmod(0o777)
    if condition == "other-env":
        return own, {"PYTHONPATH": os.environ.get("PYTHONPATH", ""), "HOME": "/nonexistent"}
    return own, own


def stop(env, connect):
    """Type the command; returns when it began [us], its exit code and its words."""
    began = monotonic_ns() // 1000
    done = subprocess.run(
        [sys.executable, "-m", "testbed", "stop", *connect], env=env, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    return began, done.returncode, done.stdout + done.stderr


def one(condition, rng, folder):
    """Fly once: late closing [ms], exit code of the first stop, valves or processes left."""
    host_env, env = surroundings(condition, folder)
    host, connect = Host([FLEET, *BUSY], folder / "report.json", host_env, PROGRAM), []
    try:
        pids, epoch = host.await_start()
        if condition in ("other-env", "no-note", "squatted"):
            connect = ["--connect", *host.find("endpoint")[0]]
        sleep_until_ns(round(epoch + rng.uniform(1.0, 3.0) * 1e9))
        if condition.startswith("host"):
            number = signal.SIGSTOP if condition == "host-hangs" else signal.SIGKILL
            os.kill(host.process.pid, number)
            if number == signal.SIGKILL:
                host.process.wait()
        first, code, said = stop(env, connect)
        sleep_until_ns(max(monotonic_ns(), 1000 * first + GAP_NS))
        second, _, _ = stop(env, connect)
        sleep_until_ns(monotonic_ns() + 1_000_000_000)
    finally:
        host.close()
    left = await_gone(pids)
    report = msgspec.json.decode((folder / "report.json").read_bytes(), type=TableReport)
    names = [name for name in pids if name != "twin"]
    missing = [name for name in names if f"{name}: stops" not in said]
    ends = [last_open_us(report, name, second) for name in names]
    late = max(0.0 if closed is None else 1e-3 * (closed - second) for closed, _ in ends)
    return late, code, missing, any(mask for _, mask in ends) or bool(left), said


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("conditions", nargs="*", default=CONDITIONS)
    parser.add_argument("--count", type=int, default=5, help="flights of each condition")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--hogs", type=int, default=0, help="processes that load the machine")
    args = parser.parse_args()
    rng, failures = np.random.default_rng(args.seed), 0
    with loaded(args.hogs):
        for condition in args.conditions:
            rows = []
            for _ in range(args.count):
                with tempfile.TemporaryDirectory(prefix="abt-stop-") as folder:
                    rows.append(one(condition, rng, Path(folder)))
            late = [row[0] for row in rows]
            bad = [row for row in rows if row[1] != 0 or row[2] or row[3]]
            failures += len(bad)
            print(
                f"{condition:11s} {len(rows)} flights, {args.hogs} hogs: second stop to last valve"
                f" p50 {np.median(late):.0f} ms, worst {max(late):.0f} ms; failed {len(bad)}",
                flush=True,
            )
            for _, code, missing, open_, said in bad:
                print(f"  exit {code}, missing {missing}, open or left {open_}: {said}", flush=True)
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
