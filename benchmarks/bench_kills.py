"""Kill, stop and cut things at random instants of a flight on the bench, and see the valves close.

    python benchmarks/bench_kills.py [CASE ...] [--count N] [--seed S]

    agent-kill  agent-stop  serial-cut     valves closed within 200 ms, SAFE latched
    host-kill   host-stop   zenoh-cut      coast: closed within 200 ms of the last command's expiry
    host-kill-vehicle  host-stop-vehicle   coast, with the law on board: the last command is the
                                           host's lease, good for a second
    host-kill-brake                        brake: at rest relative to the table, then closed

Instants are read from the stamps of the boards, on the clock of this machine (see
`firmware_interface/line_tap.py`); the host runs in a process of its own here.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from contextlib import suppress
from pathlib import Path

import msgspec
import numpy as np

from testbed.realtime.wall_clock import monotonic_ns, sleep_until_ns
from testbed.rig.wired.table_report import TableReport

CASES = (
    "agent-kill", "agent-stop", "serial-cut", "host-kill", "host-stop", "zenoh-cut",
    "host-kill-vehicle", "host-stop-vehicle", "host-kill-brake",
)  # fmt: skip
FLEET = "zhang2023_table_pd"
CALM = "zhang2023_table"
# No setpoint any more, or no host: shut, not braked. Both end about a second after the last word.
COAST = ["flight.gate.link_timeout_s=0.001", "faults.operator_gone.response=coast"]
ON_BOARD = ["deploy.law=vehicle", COAST[1]]
# A law in a hurry: valves are open most of the time.
BUSY = ["duration_s=30", "criteria={}", "controller.bandwidth=0.6"]
PATIENCE_S = 300.0

HOST = """
import json, signal, socket, sys, threading
from pathlib import Path
from testbed.rig.wired.wired_flight import LEASE_S
from testbed.rig.wired.host import WireRig
from testbed.config import find, load
from testbed.rig.observers import NullObserver
from testbed.rig.twin import warm_up

class Told(NullObserver):
    def host(self, name, tick):
        setpoint = tick.outputs.setpoint
        if setpoint is not None:
            until = rig.results.epoch_ns + setpoint.valid_until * 1e9
            print(json.dumps(["setpoint", name, until]),
                  flush=True)

    def done(self, t):
        until = rig.results.epoch_ns + (t + LEASE_S) * 1e9  # the lease was said just before
        for name in rig.experiment.vehicles:
            print(json.dumps(["lease", name, until]), flush=True)

def started(rig):
    print(json.dumps(["endpoint", rig.experiment.table.lab.network.endpoint]), flush=True)
    print(json.dumps(["start", rig.children, rig.results.epoch_ns]), flush=True)

class Relay:
    # A cable between host and vehicles, until it is cut: nothing comes through, nothing ends.
    def __init__(self, endpoint):
        self.to, self.cut = int(endpoint.rpartition(":")[2]), False
        self.door = socket.create_server(("127.0.0.1", 0))
        threading.Thread(target=self.accept, daemon=True).start()

    def accept(self):
        while True:
            near, _ = self.door.accept()
            far = socket.create_connection(("127.0.0.1", self.to))
            for pair in ((near, far), (far, near)):
                pair[0].setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                threading.Thread(target=self.pump, args=pair, daemon=True).start()

    def pump(self, one, other):
        try:
            while data := one.recv(65536):
                if not self.cut:
                    other.sendall(data)
        except OSError:
            pass
        one.close(), other.close()

relays = []
def way(endpoint):
    relays.append(Relay(endpoint))
    return "tcp/127.0.0.1:%d" % relays[-1].door.getsockname()[1]

def cut(number, frame):
    for relay in relays:  # every vehicle has a cable of its own
        relay.cut = True

experiment = load(find(sys.argv[1]), sys.argv[3:])
warm_up(experiment)
rig = WireRig(experiment, bench=True, keep=Path(sys.argv[2]), relay=way)
signal.signal(signal.SIGUSR1, cut)
rig.on_start = started
ending = rig.fly(Told())
print(json.dumps(["end", ending.t, ending.fault and ending.fault.words]), flush=True)
"""


class Host:
    """The host's process, and what it has said."""

    def __init__(self, words, report, env=None, program=HOST, user=()):
        self.said, self.lock = [], threading.Lock()
        self.process = subprocess.Popen(
            [*user, sys.executable, "-c", program, words[0], str(report), *words[1:]],
            stdout=subprocess.PIPE, text=True, start_new_session=True, env=env,
        )  # fmt: skip
        self.thread = threading.Thread(target=self._read, daemon=True)
        self.thread.start()

    def _read(self):
        for line in self.process.stdout:
            with self.lock:
                self.said.append((monotonic_ns(), json.loads(line)))

    def find(self, kind):
        with self.lock:
            return [what[1:] for _, what in self.said if what[0] == kind]

    def await_start(self):
        end = monotonic_ns() + round(PATIENCE_S * 1e9)
        while not (found := self.find("start")):
            if self.process.poll() is not None or monotonic_ns() > end:
                raise RuntimeError(f"the flight did not begin: {self.said}")
            sleep_until_ns(monotonic_ns() + 10_000_000)
        return found[0]

    def close(self):
        with suppress(ProcessLookupError):
            os.kill(self.process.pid, signal.SIGCONT)
        try:
            self.process.wait(30)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.thread.join()
        self.process.stdout.close()


def children_of_bench(pids):
    return [pid for pid in pids.values() if Path(f"/proc/{pid}").exists()]


def await_gone(pids):
    end = monotonic_ns() + 60 * 10**9
    while children_of_bench(pids) and monotonic_ns() < end:
        sleep_until_ns(monotonic_ns() + 20_000_000)
    return children_of_bench(pids)


def last_open_us(report, name, after_us):
    """When the vehicle's valves were closed for good; None if nothing was open after that."""
    edges = report.edges[name]
    mask, closed = 0, None
    for at, new in edges:
        if new == 0 and mask and at >= after_us:
            closed = at
        mask = new
    return (closed, mask)


def one_agent(case, rng, folder, name="sat1"):
    """All three vehicles of a fleet lose their agent, or their line, each at its own instant."""
    report = folder / "report.json"
    host = Host([FLEET, *BUSY], report)
    try:
        pids, epoch = host.await_start()
        names = [n for n in pids if n != "twin"]
        instants = dict(zip(names, np.sort(rng.uniform(0.5, 1.4, len(names))), strict=True))
        hit = {}
        for name, t in instants.items():
            sleep_until_ns(round(epoch + t * 1e9))
            number = signal.SIGKILL if case == "agent-kill" else signal.SIGSTOP
            if case == "serial-cut":
                os.kill(pids["twin"], signal.SIGUSR1)  # cuts the next line, see `testbed twin`
            else:
                os.kill(pids[name], number)
            hit[name] = monotonic_ns() // 1000
        sleep_until_ns(monotonic_ns() + 700_000_000)
        for name in names:
            with suppress(ProcessLookupError):
                os.kill(pids[name], signal.SIGKILL)
    finally:
        host.close()
    left = await_gone(pids)
    report = msgspec.json.decode(report.read_bytes(), type=TableReport)
    rows = []
    for name, at in hit.items():
        closed, mask = last_open_us(report, name, at)
        rows.append((
            0.0 if closed is None else 1e-3 * (closed - at),
            mask == 0,
            report.left_as[name][0] == "SAFE" and "WATCHDOG" in report.left_as[name][1],
            left,
        ))  # fmt: skip
    return rows


def one_host(case, rng, folder):
    """The host is killed, stopped or cut off; the vehicle coasts or brakes."""
    report_path, on_board = folder / "report.json", case.endswith("vehicle")
    # A vehicle that brakes must have the force to, within the time its gate leaves it.
    words = [FLEET, *BUSY, *(ON_BOARD if on_board else COAST)]
    if case.endswith("brake"):
        words = [CALM, *BUSY[:2]]
    host = Host(words, report_path)
    try:
        pids, epoch = host.await_start()
        # The vehicles are moving, and firing, when they lose the host.
        sleep_until_ns(round(epoch + rng.uniform(1.0, 3.0) * 1e9))
        if case == "zenoh-cut":
            os.kill(host.process.pid, signal.SIGUSR1)
        else:
            number = signal.SIGSTOP if case.startswith("host-stop") else signal.SIGKILL
            os.kill(host.process.pid, number)
        hit = monotonic_ns() // 1000
        sleep_until_ns(monotonic_ns() + 50_000_000)
        said = host.find("lease" if on_board else "setpoint")
        expiry = {n: 1e-3 * until for n, until in said}
        longer = case.endswith("brake") or on_board
        sleep_until_ns(monotonic_ns() + (4_000_000_000 if longer else 1_500_000_000))
        if case.startswith("host-stop"):
            os.kill(host.process.pid, signal.SIGKILL)
    finally:
        host.close()
    left = await_gone(pids)
    report = msgspec.json.decode(report_path.read_bytes(), type=TableReport)
    rows = []
    names = [n for n in pids if n != "twin"]
    for k, name in enumerate(names):
        closed, mask = last_open_us(report, name, hit)
        late = 0.0 if closed is None else 1e-3 * (closed - expiry[name])
        row = [late, mask == 0, True, left]
        if case.endswith("brake"):
            t = np.array(report.t)
            closed_at = (closed or hit) * 1000 - report.released_ns
            i = min(np.searchsorted(t, closed_at * 1e-9), len(t) - 1)
            row[2] = 1e3 * float(np.hypot(*report.states[i][k][3:5]))
        rows.append(tuple(row))
    return rows


def measure(case, count, seed):
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=tuple(case.encode())))
    rows, flights = [], 0
    one = one_agent if case.startswith(("agent", "serial")) else one_host
    while len(rows) < count:
        with tempfile.TemporaryDirectory(prefix="abt-kills-") as folder:
            rows += one(case, rng, Path(folder))
        flights += 1
    return rows, flights


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("cases", nargs="*", default=CASES)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--limit-ms", type=float, default=200.0)
    args = parser.parse_args()
    bad = 0
    for case in args.cases:
        rows, flights = measure(case, args.count, args.seed)
        late = [row[0] for row in rows]
        shut, latched = all(row[1] for row in rows), [row[2] for row in rows]
        left = sum(len(row[3]) for row in rows)
        line = (
            f"{case:16s} {len(rows)} valves' vehicles in {flights} flights:"
            f" last closing p50 {np.median(late):6.1f} ms, max {max(late):6.1f} ms;"
            f" shut {shut}; left behind {left}"
        )
        if case.endswith("brake"):
            line += f"; speed then at most {max(latched):.2f} mm/s"
        else:
            line += f"; latched {all(latched)}"
            bad += max(late) > args.limit_ms or not all(latched)
        bad += not shut or left > 0
        print(line, flush=True)
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
