"""`testbed stop` under bad conditions: stop three vehicles on the bench, and see the valves close.

    python benchmarks/stop.py [CONDITION ...] [--count N] [--seed S] [--hogs N]

    plain       the operator's terminal is that of the host
    ssh         the operator's shell has no XDG_RUNTIME_DIR
    cron        the operator's command has an empty environment
    sudo        the host belongs to another user, who types `sudo testbed stop`
    other-user  the operator is another user than the host's; with --connect
    full        the file system of the notes is full; with --connect
    squatted    another user has made the folder of the notes; with --connect
    host-hangs  the host's process is stopped (SIGSTOP)
    host-dead   the host's process was killed just before

Each flight is stopped at a random instant by the first command. The second one, 0.6 s later, shuts
valves and air at once. Printed are the time from the start of the second command to the last
valve's closing by the stamps of the boards, and whether the first command named every vehicle and
ended with 0. A flight that a fault had ended before the first command says nothing about the time:
the command has to say so and to end with 0, and another one is flown instead.

It needs root, for other users and for folders of its own: everything happens in a mount and a
network namespace with a /tmp of their own, so that no other flight on this machine is stopped. The
programs must not lie below /tmp.
"""

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import msgspec
import numba
import numpy as np
from bench_kills import BUSY, FLEET, HOST, Host, await_gone, last_open_us
from load import loaded

from testbed.config import find, load
from testbed.net.flight_note import known_flights
from testbed.realtime.wall_clock import monotonic_ns, sleep_until_ns
from testbed.rig.twin import warm_up
from testbed.rig.wired.table_report import TableReport

CONDITIONS = (
    "plain", "ssh", "cron", "sudo", "other-user", "full", "squatted", "host-hangs", "host-dead",
)  # fmt: skip
CONNECTS = ("other-user", "full", "squatted")  # no note can be read there
GAP_NS = 600_000_000
PROGRAM = HOST.replace(", relay=way", "")  # the vehicles know the port of the host
NOBODY = 65534
AS_NOBODY = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups"]
# the host's processes must find an interpreter that may lie in root's home
SEARCHES = ["--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search"]
INSIDE = "ABT_STOP_INSIDE"
NOTES = Path("/run/user")


class Stopped(NamedTuple):
    """How one flight was stopped."""

    late_ms: float  # from the second command to the last valve's closing
    code: int  # exit code of the first command
    missing: list[str]  # vehicles that it did not name
    open_or_left: bool  # valves or processes, afterwards
    over: bool  # the flight had ended before
    said: str

    @property
    def failed(self):
        return self.code != 0 or bool(self.missing) or self.open_or_left


def enclose():
    """Begin again in namespaces with their own network and `NOTES`."""
    words = ["unshare", "--mount", "--net", sys.executable, *sys.argv]
    os.execvpe(words[0], words, os.environ | {INSIDE: "1"})


def furnish():
    """Make a network, and the folders of both users, which logging in makes elsewhere.

    Raises:
        RuntimeError: a flight of another program can be seen, and would be stopped.
    """
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    for folder in (NOTES, Path("/tmp")):
        subprocess.run(["mount", "-t", "tmpfs", "none", folder], check=True)
    NOTES.chmod(0o755)
    Path("/tmp").chmod(0o1777)
    for uid in (0, NOBODY):
        folder = NOTES / str(uid)
        folder.mkdir(mode=0o700)
        os.chown(folder, uid, uid)
    os.environ.pop("XDG_RUNTIME_DIR", None)
    if found := list(known_flights()):
        raise RuntimeError(f"flights of other programs: {found}")


def surroundings(condition, home):
    """How the host and the operator are started: words before the command, and environment."""
    path = {"PATH": os.environ["PATH"], "PYTHONPATH": os.environ.get("PYTHONPATH", "")}
    without = {key: value for key, value in os.environ.items() if key != "XDG_RUNTIME_DIR"}
    own = without | {"XDG_RUNTIME_DIR": str(NOTES / "0")}
    notes = NOTES / "0" / "airbearing-testbed-0"
    subprocess.run(["umount", "-q", notes], check=False, stderr=subprocess.DEVNULL)
    shutil.rmtree(notes, ignore_errors=True)
    if condition == "ssh":
        return [], own, [], without
    if condition == "cron":
        return [], own, [], path
    if condition == "sudo":
        theirs = {"HOME": str(home), "XDG_RUNTIME_DIR": str(NOTES / str(NOBODY))}
        asked = path | {"SUDO_UID": str(NOBODY)}
        return [*AS_NOBODY, *SEARCHES], path | theirs, [], asked
    if condition == "other-user":
        return [], own, AS_NOBODY, path
    if condition == "full":
        notes.mkdir(mode=0o700)
        subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=4k,mode=700", "none", notes], check=True
        )
        (notes / "filler").write_bytes(bytes(4096))
    if condition == "squatted":
        notes.mkdir(mode=0o777)
        os.chown(notes, NOBODY, NOBODY)
    return [], own, [], own


def stop(words, env, connect):
    """Type the command; returns when it began [us], its exit code and its words."""
    began = monotonic_ns() // 1000
    done = subprocess.run(
        [*words, sys.executable, "-m", "testbed", "stop", *connect], env=env, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    return began, done.returncode, done.stdout + done.stderr


def one(condition, rng, folder, home):
    """Fly once: see `Stopped`."""
    user, host_env, other, env = surroundings(condition, home)
    folder.chmod(0o777)
    host = Host([FLEET, *BUSY], folder / "report.json", host_env, PROGRAM, user)
    connect = []
    try:
        pids, epoch = host.await_start()
        if condition in CONNECTS:
            connect = ["--connect", *host.find("endpoint")[0]]
        sleep_until_ns(round(epoch + rng.uniform(1.0, 3.0) * 1e9))
        if condition.startswith("host"):
            number = signal.SIGSTOP if condition == "host-hangs" else signal.SIGKILL
            os.kill(host.process.pid, number)
            if number == signal.SIGKILL:
                host.process.wait()
        first, code, said = stop(other, env, connect)
        sleep_until_ns(max(monotonic_ns(), 1000 * first + GAP_NS))
        second, _, _ = stop(other, env, connect)
        sleep_until_ns(monotonic_ns() + 1_000_000_000)
    finally:
        host.close()
    left = await_gone(pids)
    over = "had ended" in said
    said += f"its host: {host.find('end')}\n"
    report = msgspec.json.decode((folder / "report.json").read_bytes(), type=TableReport)
    names = [name for name in pids if name != "twin"]
    said_of = [f"{name}: {'had ended, bearing air off' if over else 'stops'}" for name in names]
    missing = [name for name, words in zip(names, said_of, strict=True) if words not in said]
    ends = [last_open_us(report, name, second) for name in names]
    late = max(0.0 if closed is None else 1e-3 * (closed - second) for closed, _ in ends)
    return Stopped(late, code, missing, any(mask for _, mask in ends) or bool(left), over, said)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("conditions", nargs="*", default=CONDITIONS)
    parser.add_argument("--count", type=int, default=5, help="flights of each condition")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--hogs", type=int, default=0, help="processes that load the machine")
    args = parser.parse_args()
    if INSIDE not in os.environ:
        enclose()
    furnish()
    rng, failures = np.random.default_rng(args.seed), 0
    with tempfile.TemporaryDirectory(prefix="abt-home-") as home, loaded(args.hogs):
        warm_up(load(find(FLEET)))
        kept = Path(numba.config.CACHE_DIR)  # the other user's host need not compile again
        shutil.copytree(kept, Path(home) / ".cache" / "airbearing-testbed" / kept.name)
        subprocess.run(["chown", "-R", f"{NOBODY}:{NOBODY}", home], check=True)
        for condition in args.conditions:
            rows, tries = [], 2 * args.count
            while len(rows) < args.count:
                tries -= 1
                with tempfile.TemporaryDirectory(prefix="abt-stop-") as folder:
                    try:
                        stopped = one(condition, rng, Path(folder), home)
                    except RuntimeError as error:  # not armed: the machine is too busy
                        print(f"  {condition}: {error}", flush=True)
                        if tries <= 0:
                            raise
                        continue
                if stopped.failed or stopped.over:
                    print(f"  {condition} {len(rows)}: {stopped}", flush=True)
                if stopped.over:
                    failures += stopped.failed
                else:
                    print(f"  {condition} {len(rows)}: {stopped.late_ms:.0f} ms", flush=True)
                    rows.append(stopped)
            late = [row.late_ms for row in rows]
            bad = sum(row.failed for row in rows)
            failures += bad
            level = os.getloadavg()[0]
            print(
                f"{condition:11s} {len(rows)} flights at load {level:.0f}: from the second stop to"
                f" the last valve p50 {np.median(late):.0f} ms, worst {max(late):.0f} ms;"
                f" failed {bad}",
                flush=True,
            )
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
